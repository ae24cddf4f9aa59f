"""`vantage train caught`: learn to say "caught" without a view (hazard, coordinate-value). Reads from top to bottom."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from learning.caught_batch import Batch, render
from learning.compiling import to_compile
from learning.dataset import Dataset, prefetch
from learning.group import Group, join_group
from learning.measures import measures_of_logits
from learning.methods.survival import caught_logits
from learning.recipe import CaughtModel, CaughtRecipe, caught_notes_of, caught_recipe, rate_factor
from learning.tensors import in_unit_range, on_device
from learning.trainer import GradientTrainer
from learning.training_identity import identity_of
from learning.training_run import TrainingRun, training_samples
from learning.training_settings import Place, TrainingSettings, given, places_of
from vantage.networks.coordinate_value import CoordinateValue, CoordinateValueSettings
from vantage.networks.hazard import Hazard, HazardSettings, survival_loss
from vantage.networks.hazard_attention import HazardAttention, HazardAttentionSettings
from vantage.networks.weights import ModelCard


@dataclass(frozen=True)
class TrainCaughtSettings(TrainingSettings):
    """Learn to say whether a plan ends in a catch, without predicting a view.

    Example: vantage train caught --model hazard --preset compact --minutes 15
    """

    model: CaughtModel = "hazard"
    """`hazard`: state image, F and T of the whole plan -> the chance of a catch in every interval. `hazard-attention`: the same,
    from the plan as a sequence of positions. `coordinate-path`, `coordinate-end`: the paper's baseline, told the path every ten
    steps and the horizon, or the end of the path alone."""
    preset: Literal["paper", "compact"] = "paper"
    """`paper`: VPT-TOB's encoder and recipe. `compact`: smaller, for minutes on a CPU core."""
    rate: float | None = None
    """Learning rate, instead of the preset's."""
    validation: int = 2048
    """Samples of validation games to choose the best weights by."""


def resolve(settings: TrainCaughtSettings) -> CaughtRecipe:
    """Return the preset with what the command line changes."""
    changed = given(settings, "samples", "batch", "rate", "schedule", "drop")
    return replace(caught_recipe(settings.model, settings.preset), **changed)


def make_network(model: CaughtModel, recipe: CaughtRecipe) -> Hazard | HazardAttention | CoordinateValue:
    """Return an untrained network."""
    if model == "hazard-attention":
        return HazardAttention(HazardAttentionSettings(encoder=recipe.encoder))
    shape: dict[str, Any] = {name: getattr(recipe, name) for name in ("encoder", "whole_image", "dropout")}
    if model == "hazard":
        return Hazard(HazardSettings(**shape))
    return CoordinateValue(CoordinateValueSettings(variant="path" if model == "coordinate-path" else "end", **shape))


class Trainer(GradientTrainer[Batch]):
    """A network that says "caught" and its loss."""

    network: Hazard | HazardAttention | CoordinateValue

    def __init__(self, model: CaughtModel, recipe: CaughtRecipe, group: Group, compiled: bool, seed: int) -> None:
        super().__init__(recipe, group, compiled)
        torch.manual_seed(seed)
        self.network = make_network(model, recipe).to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.parameters = list(self.network.parameters())
        self.optimizer = torch.optim.AdamW(self.parameters, recipe.rate, weight_decay=recipe.weight_decay, fused=True)

    def forward(self, images: Tensor, vectors: Tensor) -> Tensor:
        """uint8 [B, 128, 128, C], float [B, 121 or 0] -> logits [B, K], or [B, 1] at the horizon."""
        pixels = in_unit_range(images, self.precision)
        with torch.autocast(self.device.type, self.precision, enabled=self.precision != torch.float32):
            if isinstance(self.network, Hazard):
                return self.network(pixels).float()
            found = self.network(pixels, vectors).float()
            return found if isinstance(self.network, HazardAttention) else found[:, None]

    def tensors(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return images, vectors, caught and known on the device."""
        arrays = (batch.images, batch.vectors, batch.caught, batch.known)
        images, vectors, caught, known = (on_device(array, self.device) for array in arrays)
        return images, vectors, caught, known

    def loss_of(self, batch: Batch, forward: Callable[..., Tensor]) -> Tensor:
        images, vectors, caught, known = self.tensors(batch)
        return survival_loss(forward(images, vectors), caught, known)

    @torch.inference_mode()
    def validate(self, batches: Iterator[Batch]) -> dict[str, float]:
        """Return what can be said of "caught" at the horizons of the samples."""
        self.network.eval()
        scores, truth = [], []
        for batch in batches:
            images, vectors, _, _ = self.tensors(batch)
            logits = self.forward(images, vectors).cpu().numpy()
            if isinstance(self.network, Hazard | HazardAttention):
                scores.append(caught_logits(logits, batch.samples.horizon, self.network.settings.spacing))
            else:
                scores.append(logits[:, 0])
            truth.append(batch.samples.caught)
        self.network.train()
        return measures_of_logits(np.concatenate(scores), np.concatenate(truth))


def main(settings: TrainCaughtSettings) -> int:
    """Train, with one seed after the other; returns the exit code."""
    places, group, data = places_of(settings, settings.model), join_group(), Dataset(settings.data)
    torch.set_num_threads(settings.threads_of(group))
    for place in places:
        train(settings, place, group, data)
    group.leave()
    return 0


def train(settings: TrainCaughtSettings, place: Place, group: Group, data: Dataset) -> None:
    """Train with one seed, or go on with it."""
    recipe, model, seed = resolve(settings), settings.model, place.seed
    compiled, why = to_compile(settings.compile, group.device, recipe.samples, settings.minutes)
    trainer = Trainer(model, recipe, group, compiled, seed)
    plain = replace(recipe, samples=0)
    identity = identity_of(settings, seed, group, data, plain, model=model, validation=settings.validation)
    run = TrainingRun.of(settings, place, identity, group, recipe.samples)
    run.introduce(f"{model} `{settings.preset}`", data, trainer.network, f"{trainer.precision}; {why}")
    if saved := run.resume(settings.resume):
        trainer.restore(saved["trainer"])
    if run.is_over:
        return

    held = data.draw("validation", settings.validation, np.random.default_rng(0), recipe.from_start, symmetries=1)
    drawn = training_samples(data, recipe, seed, run.batch_numbers(recipe.batch))

    def step() -> tuple[int, Tensor]:
        return recipe.batch * group.size, trainer.learn(next(stream), rate_factor(recipe, run.progress))

    def validate() -> dict[str, float]:
        parts = (held.part(first, first + 128) for first in range(0, len(held), 128))
        return trainer.validate(render(trainer.network, data, part) for part in run.interruptible(parts))

    def make_card() -> ModelCard:
        return run.model_card(trainer.network, settings.preset, data, recipe, caught_notes_of(model, recipe))

    stream = prefetch(lambda: (render(trainer.network, data, samples) for samples in drawn))
    run.train(
        step,
        validate,
        trainer.network,
        make_card,
        lambda: {"trainer": trainer.state()},
        lambda: {"training/rate": recipe.rate * rate_factor(recipe, run.progress)},
    )
    run.finish()
