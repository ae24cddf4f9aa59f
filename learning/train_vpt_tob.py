"""`vantage train vpt-tob`: learn to predict a view (paper, VPT-TOB Network; and its baselines). Reads from top to bottom."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from learning.compiling import to_compile
from learning.dataset import Dataset, prefetch
from learning.device_loader import DeviceDataset, Resident, fits, needed_bytes
from learning.group import join_group
from learning.panel import draw_panel
from learning.recipe import PRESETS, Recipe, notes_of, rate_factor
from learning.tensors import Tensors, tensors_of
from learning.trainer import Model, Trainer, target_of
from learning.training_run import OtherTraining, TrainingRun, training_samples
from learning.training_settings import TrainingSettings, given
from vantage.networks.weights import ModelCard, amend, load_any, save


@dataclass(frozen=True)
class TrainVptTobSettings(TrainingSettings):
    """Learn to predict the seeker's view from the hider's view and its planned path.

    Example: vantage train vpt-tob --data dataset/ --preset compact --minutes 40
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
    workspace: Path | None = None
    """Folder of the checkpoint, of the curves for TensorBoard and of pictures of predictions; runs/MODEL if not said."""
    resident: Resident = "auto"
    """Keep the training set in the device's memory and render there; `auto`: on a GPU that has twice that memory free."""


def resolve(settings: TrainVptTobSettings) -> Recipe:
    """Return the preset with what the command line changes."""
    changed = given(settings, "samples", "batch", "schedule", "drop", "disc_weight", "judge_weight", "head_weight")
    recipe = replace(PRESETS[settings.preset], **changed)
    return replace(recipe, network=replace(recipe.network, caught_head=recipe.head_weight > 0))


def settled(identity: dict[str, Any]) -> dict[str, Any]:
    """Return the identity in a checkpoint; what an earlier version did not write was then as it is by default."""
    return {"model": "vpt-tob", **identity, "recipe": {**asdict(Recipe()), **identity["recipe"]}}


def main(settings: TrainVptTobSettings) -> int:
    """Train; returns the exit code."""
    group = join_group()
    torch.set_num_threads(settings.threads_of(group))
    recipe, data, model, target = resolve(settings), Dataset(settings.data), settings.model, target_of(settings.model)
    compiled, why = to_compile(settings.compile, group.device, recipe.samples, settings.minutes)
    trainer = Trainer(model, recipe, group, compiled, settings.seed)
    identity = {"model": model, "recipe": asdict(replace(recipe, samples=0)), "data": data.hash}
    run = TrainingRun.of(settings, identity, group, recipe.samples)
    run.introduce(settings, data, trainer.network, f"{trainer.precision}; {why}")
    resident = fits(data, group.device) if settings.resident == "auto" else settings.resident == "on"
    if resident:
        run.say(
            f"the training set goes to the memory of {group.device} ({needed_bytes(data) / 1e9:.1f} GB) and is rendered there"
        )

    begun_with: dict[str, str] = {}
    if settings.start:
        earlier, earlier_card = load_any(settings.start, (model,))
        if earlier.settings != trainer.network.settings:
            return run.refuse(f"{settings.start} holds another network than the preset `{settings.preset}`: {earlier.settings}")
        trainer.network.load_state_dict(earlier.state_dict())
        begun_with = {settings.start.name: earlier_card.sha256}

    try:
        if settings.resume and (saved := run.resume(settled=settled)):
            trainer.restore(saved["trainer"])
    except OtherTraining as error:
        return run.refuse(error)

    held = data.draw("validation", settings.validation, np.random.default_rng(0), recipe.from_start, symmetries=1)
    drawn = training_samples(data, recipe, settings.seed, run.batch_numbers(recipe.batch))
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

    def make_card() -> ModelCard:
        seen = {"samples": run.seen, "best after": run.seen}
        card = run.model_card(trainer.network, settings.preset, data, recipe, seen, settings.seed)
        card.training["target"] = f"the {target}'s view"
        card.notes, card.inputs = notes_of(recipe), begun_with
        if target == "hider":
            card.notes = ["A baseline: predicts the hider's own later view, not the seeker's.", *card.notes]
        return card

    stream = batches()
    run.begin()
    while run.progress < 1.0:
        loss = trainer.learn(next(stream), rate_factor(recipe, run.progress))
        run.count(recipe.batch * group.size, loss)
        if run.report_is_due:
            measures, (batch, views) = trainer.validate(data.batches(held, 64, target, vectors))
            run.show("predictions", draw_panel(settings.folder / "latest.png", batch, views, target))
            if better := run.keep_if_best(measures):
                save(trainer.network, settings.weights, make_card())
            rate = recipe.rate * rate_factor(recipe, run.progress)
            run.report(measures, better, {"training/rate": rate, "samples a second": run.speed})
        if run.checkpoint_is_due:
            run.write_checkpoint({"trainer": trainer.state()})
    if group.rank == 0:
        amend(settings.weights, samples=run.seen, minutes=run.trained / 60)
    run.finish(settings.weights)
    return 0


if __name__ == "__main__":  # for torchrun
    import sys

    import tyro

    sys.exit(main(tyro.cli(TrainVptTobSettings)))
