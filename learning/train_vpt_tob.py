"""`vantage train vpt-tob`: learn to predict a view (paper, VPT-TOB Network; and its baselines). Reads from top to bottom."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from learning.compiling import to_compile
from learning.dataset import Dataset, prefetch
from learning.device_loader import DeviceDataset, Resident, fits, needed_bytes
from learning.group import Group, join_group
from learning.panel import draw_panel
from learning.recipe import PRESETS, Recipe, notes_of, rate_factor
from learning.tensors import Tensors, tensors_of
from learning.trainer import Model, Trainer, target_of
from learning.training_identity import identity_of
from learning.training_run import TrainingRun, training_samples
from learning.training_settings import Place, TrainingSettings, UnusableTraining, given, places_of
from vantage.networks.weights import ModelCard, load_any


@dataclass(frozen=True)
class TrainVptTobSettings(TrainingSettings):
    """Learn to predict the seeker's view from the hider's view and its planned path.

    Example: vantage train vpt-tob --preset compact --minutes 40
    """

    model: Model = "vpt-tob"
    """`vpt-tob`. Baselines: `self-perspective` predicts the hider's own view; `vector-action` is told the path as numbers."""
    preset: Literal["paper", "whole-image", "compact"] = "paper"
    """`paper`: the paper's network and recipe. `whole-image`: the same with a bottleneck that sees the whole image. `compact`:
    a smaller network and a recipe for an hour on two CPU cores."""
    start: Path | None = None
    """Begin with these weights (of the same network), not from scratch; the model card names them."""
    disc_weight: float | None = None
    """Weight of the robots' pixels, instead of the preset's."""
    judge_weight: float | None = None
    """Weight of the judge's loss, instead of the preset's."""
    head_weight: float | None = None
    """Weight of the caught head's loss, instead of the preset's."""
    resident: Resident = "auto"
    """Keep the training set in the device's memory and render there; `auto`: on a GPU that has twice that memory free."""


def resolve(settings: TrainVptTobSettings) -> Recipe:
    """Return the preset with what the command line changes."""
    changed = given(settings, "samples", "batch", "schedule", "drop", "disc_weight", "judge_weight", "head_weight")
    recipe = replace(PRESETS[settings.preset], **changed)
    return replace(recipe, network=replace(recipe.network, caught_head=recipe.head_weight > 0))


def main(settings: TrainVptTobSettings) -> int:
    """Train, with one seed after the other; returns the exit code."""
    places, group, data = places_of(settings, settings.model), join_group(), Dataset(settings.data)
    torch.set_num_threads(settings.threads_of(group))
    for place in places:
        train(settings, place, group, data)
    group.leave()
    return 0


def train(settings: TrainVptTobSettings, place: Place, group: Group, data: Dataset) -> None:
    """Train with one seed, or go on with it."""
    recipe, model, target = resolve(settings), settings.model, target_of(settings.model)
    compiled, why = to_compile(settings.compile, group.device, recipe.samples, settings.minutes)
    trainer = Trainer(model, recipe, group, compiled, place.seed)
    begun_with: dict[str, str] = {}
    if settings.start:
        earlier, earlier_card = load_any(settings.start, (model,))
        if earlier.settings != trainer.network.settings:
            raise UnusableTraining(
                f"{settings.start} holds another network than the preset `{settings.preset}`: {earlier.settings}"
            )
        trainer.network.load_state_dict(earlier.state_dict())
        begun_with = {settings.start.name: earlier_card.sha256}
    plain, seed = replace(recipe, samples=0), place.seed
    weights_in = sorted(begun_with.values())
    identity = identity_of(settings, seed, group, data, plain, model=model, validation=settings.validation, start=weights_in)
    run = TrainingRun.of(settings, place, identity, group, recipe.samples)
    run.introduce(f"{model} `{settings.preset}`", data, trainer.network, f"{trainer.precision}; {why}")
    if saved := run.resume(settings.resume):
        trainer.restore(saved["trainer"])
    if run.is_over:
        return
    resident = fits(data, group.device) if settings.resident == "auto" else settings.resident == "on"
    if resident:
        size = needed_bytes(data) / 1e9
        run.say(f"the training set goes to the memory of {group.device} ({size:.1f} GB) and is rendered there")

    held = data.draw("validation", settings.validation, np.random.default_rng(0), recipe.from_start, symmetries=1)
    drawn = training_samples(data, recipe, seed, run.batch_numbers(recipe.batch))
    vectors = model == "vector-action"

    def batches() -> Iterator[Tensors]:
        """Whatever is learnt from comes from here, on the device."""
        if resident:
            there = DeviceDataset(data, group.device)
            for samples in drawn:
                yield there.render(samples, target, vectors)
        else:
            for batch in prefetch(lambda: (data.render(samples, target, vectors) for samples in drawn)):
                yield tensors_of(batch, group.device)

    def step() -> tuple[int, torch.Tensor]:
        return recipe.batch * group.size, trainer.learn(next(stream), rate_factor(recipe, run.progress))

    def validate() -> dict[str, float]:
        measures, (batch, views) = trainer.validate(run.interruptible(data.batches(held, 64, target, vectors)))
        run.show("predictions", draw_panel(place.workspace / "latest.png", batch, views, target))
        return measures

    def make_card() -> ModelCard:
        card = run.model_card(trainer.network, settings.preset, data, recipe, notes_of(recipe))
        card.training["target"] = f"the {target}'s view"
        card.inputs = begun_with
        if target == "hider":
            card.notes = ["A baseline: predicts the hider's own later view, not the seeker's.", *card.notes]
        return card

    stream = batches()
    run.train(
        step,
        validate,
        trainer.network,
        make_card,
        lambda: {"trainer": trainer.state()},
        lambda: {"training/rate": recipe.rate * rate_factor(recipe, run.progress)},
    )
    run.finish()
