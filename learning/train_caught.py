"""`vantage train caught`: learn to say "caught" without a view (hazard, coordinate-value). Reads from top to bottom."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch._dynamo.exc import TorchDynamoException

from learning.board import Board
from learning.caught_batch import Batch, render
from learning.compiling import Compile, to_compile
from learning.dataset import Dataset, prefetch
from learning.group import Group, join_group
from learning.measures import accuracy, area_under_roc, balanced_accuracy
from learning.methods.survival import caught_logits
from learning.recipe import CaughtModel, CaughtRecipe, Schedule, caught_notes_of, caught_recipe, rate_factor
from learning.tensors import in_unit_range, on_device
from vantage.log import source_commit
from vantage.networks.coordinate_value import CoordinateValue, CoordinateValueSettings
from vantage.networks.hazard import Hazard, HazardSettings, survival_loss
from vantage.networks.hazard_attention import HazardAttention, HazardAttentionSettings
from vantage.networks.weights import ModelCard, amend, card_of, fast_precision, save


@dataclass(frozen=True)
class TrainCaughtSettings:
    """Learn to say whether a plan ends in a catch, without predicting a view.

    Example: vantage train caught --model hazard --data dataset/ --preset compact --minutes 15 --to weights/hazard.safetensors
    """

    model: CaughtModel = "hazard"
    """`hazard`: state image, F and T of the whole plan -> the chance of a catch in every interval. `hazard-attention`: the same,
    from the plan as a sequence of positions. `coordinate-path`, `coordinate-end`: the paper's baseline, told the path every ten
    steps and the horizon, or the end of the path alone."""
    data: Path = Path("dataset")
    """The training set."""
    to: Path | None = None
    """Where the weights go, runs/MODEL.safetensors if not said; the model card lies beside them."""
    preset: Literal["paper", "compact"] = "paper"
    """`paper`: VPT-TOB's encoder and recipe. `compact`: smaller, for minutes on a CPU core."""
    minutes: float | None = None
    """Train for this long instead of a number of samples."""
    samples: int | None = None
    """Train on so many samples instead of the preset's number."""
    batch: int | None = None
    """Batch size, instead of the preset's."""
    rate: float | None = None
    """Learning rate, instead of the preset's."""
    schedule: Schedule | None = None
    """`steps` multiplies the learning rate by --drop at 25 % and 65 %, `cosine` ends at zero; instead of the preset's."""
    drop: float | None = None
    """Factor of the learning rate: 0.9, 0.5 and 0.1 are the readings of the paper."""
    workspace: Path | None = None
    """Folder of the checkpoint and of the curves for TensorBoard; runs/MODEL if not said."""
    resume: bool = True
    """Go on from the checkpoint, if the workspace holds one."""
    report_every: int = 16_384
    """Samples between validations."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints."""
    threads: int = 0
    """CPU threads; 0 = all cores."""
    validation: int = 2048
    """Samples of validation games to choose the best weights by."""
    compile: Compile = "auto"
    """Compile the network (a third faster); `auto`: where a compiler is there and the training is long enough."""
    seed: int = 1


def resolve(settings: TrainCaughtSettings) -> CaughtRecipe:
    """Return the preset with what the command line changes."""
    names = ("samples", "batch", "rate", "schedule", "drop")
    return replace(
        caught_recipe(settings.model, settings.preset),
        **{name: value for name in names if (value := getattr(settings, name)) is not None},
    )


def make_network(model: CaughtModel, recipe: CaughtRecipe) -> Hazard | HazardAttention | CoordinateValue:
    """Return an untrained network."""
    if model == "hazard-attention":
        return HazardAttention(HazardAttentionSettings(encoder=recipe.encoder))
    shape: dict[str, Any] = {name: getattr(recipe, name) for name in ("encoder", "whole_image", "dropout")}
    if model == "hazard":
        return Hazard(HazardSettings(**shape))
    return CoordinateValue(CoordinateValueSettings(variant="path" if model == "coordinate-path" else "end", **shape))


class Trainer:
    """Network, optimiser and loss: all that a checkpoint holds."""

    def __init__(self, model: CaughtModel, recipe: CaughtRecipe, group: Group, compiled: bool, seed: int) -> None:
        torch.manual_seed(seed)
        self.recipe, self.group, self.device = recipe, group, group.device
        self.precision = fast_precision(group.device)
        self.network = make_network(model, recipe).to(group.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.parameters = list(self.network.parameters())
        self.optimizer = torch.optim.AdamW(self.parameters, recipe.rate, weight_decay=recipe.weight_decay, fused=True)
        self.logits_in_training = torch.compile(self.logits) if compiled else self.logits

    def logits(self, images: Tensor, vectors: Tensor) -> Tensor:
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

    def learn(self, batch: Batch, factor: float) -> Tensor:
        """One step of the optimiser; returns the loss."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.recipe.rate * factor
        images, vectors, caught, known = self.tensors(batch)
        try:
            loss = survival_loss(self.logits_in_training(images, vectors), caught, known)
            loss.backward()
        except TorchDynamoException as error:
            print(f"going on without compiling, it failed: {str(error).strip().splitlines()[0]}", flush=True)
            self.logits_in_training = self.logits
            self.optimizer.zero_grad(set_to_none=True)
            loss = survival_loss(self.logits(images, vectors), caught, known)
            loss.backward()
        self.group.average(self.parameters)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        return loss.detach()

    @torch.inference_mode()
    def validate(self, batches: Iterator[Batch]) -> dict[str, float]:
        """Return what can be said of "caught" at the horizons of the samples; `loss` is the negative log-likelihood."""
        self.network.eval()
        scores, truth = [], []
        for batch in batches:
            images, vectors, _, _ = self.tensors(batch)
            logits = self.logits(images, vectors).cpu().numpy()
            if isinstance(self.network, Hazard | HazardAttention):
                scores.append(caught_logits(logits, batch.samples.horizon, self.network.settings.spacing))
            else:
                scores.append(logits[:, 0])
            truth.append(batch.samples.caught)
        self.network.train()
        score, caught = np.concatenate(scores), np.concatenate(truth)
        return {
            "loss": float(np.logaddexp(0.0, np.where(caught, -score, score)).mean()),
            "accuracy": accuracy(score > 0, caught),
            "balanced accuracy": balanced_accuracy(score > 0, caught),
            "AUROC": area_under_roc(score, caught),
        }

    def state(self) -> dict[str, Any]:
        return {"network": self.network.state_dict(), "optimizer": self.optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])


def main(settings: TrainCaughtSettings) -> int:
    """Train; returns the exit code."""
    group = join_group()
    torch.set_num_threads(settings.threads or max(1, (os.cpu_count() or 1) // group.size))
    say = partial(print, flush=True) if group.rank == 0 else lambda *_: None
    recipe, data = resolve(settings), Dataset(settings.data)
    to = settings.to or Path("runs", f"{settings.model}.safetensors")
    workspace = settings.workspace or Path("runs", settings.model)
    compiled, why = to_compile(settings.compile, group.device, recipe.samples, settings.minutes)
    trainer = Trainer(settings.model, recipe, group, compiled, settings.seed)
    size = sum(parameter.numel() for parameter in trainer.parameters)
    say(f"{settings.model} `{settings.preset}`, {size:,} parameters, {group.size} x {group.device}, {trainer.precision}; {why}")
    say(f"{settings.data}: episodes {data.manifest['episodes']}, by hider {data.manifest['hiders']}")

    checkpoint = workspace / "checkpoint.pt"
    identity = {"model": settings.model, "recipe": asdict(replace(recipe, samples=0)), "data": data.hash}
    seen, trained, best, best_measures = 0, 0.0, math.inf, dict[str, float]()  # samples, seconds
    if settings.resume and checkpoint.exists():
        saved = torch.load(checkpoint, map_location=group.device, weights_only=True)
        if saved["identity"] != identity:
            say(f"{checkpoint} is of another recipe or training set: choose another --workspace, or --no-resume")
            return 1
        trainer.restore(saved["trainer"])
        seen, trained, best, best_measures = saved["seen"], saved["trained"], saved["best"], saved["best_measures"]
        say(f"going on after {seen:,} samples, {trained / 60:.1f} minutes")
    board = Board(workspace, seen) if group.rank == 0 else None

    held = data.draw("validation", settings.validation, np.random.default_rng(0), recipe.from_start, symmetries=1)

    def batches() -> Iterator[Batch]:
        number = seen // recipe.batch + group.rank
        while True:  # a batch depends on its number alone, so that a resumed run goes on as if never stopped
            generator = np.random.default_rng([settings.seed, number])
            drawn = data.draw("train", recipe.batch, generator, recipe.from_start, symmetries=recipe.symmetries)
            yield render(trainer.network, data, drawn)
            number += group.size

    def held_batches() -> Iterator[Batch]:
        for first in range(0, len(held), 128):
            yield render(trainer.network, data, held.part(first, first + 128))

    def progress() -> float:
        return group.from_first(trained / (60 * settings.minutes) if settings.minutes else seen / recipe.samples)

    def write_checkpoint() -> None:
        workspace.mkdir(parents=True, exist_ok=True)
        state = {"identity": identity, "trainer": trainer.state(), "seen": seen, "trained": trained}
        partial_path = checkpoint.with_suffix(".partial")
        torch.save({**state, "best": best, "best_measures": best_measures}, partial_path)
        os.replace(partial_path, checkpoint)

    def make_card(measures: dict[str, float]) -> ModelCard:
        card = card_of(trainer.network)
        card.preset, card.commit, card.metrics = settings.preset, source_commit(), measures
        card.data = {key: data.manifest[key] for key in ("hash", "episodes", "hiders", "seekers", "layouts", "horizons")}
        run = {"samples": seen, "best after": seen, "minutes": trained / 60, "device": str(group.device), "seed": settings.seed}
        card.training = {**asdict(recipe), **run}
        card.notes = caught_notes_of(settings.model, recipe)
        return card

    stream = prefetch(batches)
    loss, steps = torch.zeros((), device=group.device), 0  # summed since the last report
    reported, reported_at, written_at, clock = seen, trained, trained, time.monotonic()
    done = progress()
    while done < 1.0:
        loss += trainer.learn(next(stream), rate_factor(recipe, done))
        steps += 1
        seen += recipe.batch * group.size
        trained, clock = trained + time.monotonic() - clock, time.monotonic()
        done = progress()
        if group.rank == 0 and (seen - reported >= settings.report_every or done >= 1.0):
            measures = trainer.validate(held_batches())
            better = measures["loss"] < best
            if better:
                best, best_measures = measures["loss"], measures
                save(trainer.network, to, make_card(measures))
            speed, left = (seen - reported) / max(trained - reported_at, 1e-9), trained * (1 / max(done, 1e-9) - 1) / 60
            parts = "  ".join(f"{name} {value:.4f}" for name, value in measures.items())
            say(
                f"{100 * done:5.1f} %  {seen:>9,} samples  {speed:4.0f}/s  {max(left, 0):4.0f} min left"
                f"  loss {loss.item() / steps:.4f}  validation: {parts}{'  * saved' if better else ''}"
            )
            if board:
                curves = {f"validation/{name}": value for name, value in measures.items()}
                rate = recipe.rate * rate_factor(recipe, done)
                board.curves(
                    {**curves, "training/loss": loss.item() / steps, "training/rate": rate, "samples a second": speed}, seen
                )
            loss.zero_()
            steps, reported, reported_at, clock = 0, seen, trained, time.monotonic()
        if group.rank == 0 and (trained - written_at >= 60 * settings.checkpoint_minutes or done >= 1.0):
            write_checkpoint()
            written_at, clock = trained, time.monotonic()
    if group.rank == 0:
        amend(to, samples=seen, minutes=trained / 60)
    say(f"best validation: {best_measures}; weights in {to}")
    if board:
        board.close()
    group.leave()
    return 0


if __name__ == "__main__":  # for torchrun
    import sys

    import tyro

    sys.exit(main(tyro.cli(TrainCaughtSettings)))
