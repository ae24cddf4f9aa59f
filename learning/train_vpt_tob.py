"""`vantage train vpt-tob`: learn to predict a view (paper, VPT-TOB Network; and its baselines). Reads from top to bottom."""

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

from learning.board import Board
from learning.compiling import Compile, to_compile
from learning.dataset import Dataset, Samples, prefetch
from learning.device_loader import DeviceDataset, Resident, fits, needed_bytes
from learning.group import join_group
from learning.panel import draw_panel
from learning.recipe import PRESETS, Recipe, Schedule, notes_of, rate_factor
from learning.tensors import Tensors, tensors_of
from learning.trainer import Model, Trainer, target_of
from vantage.log import source_commit
from vantage.networks.weights import ModelCard, amend, card_of, load_any, save


@dataclass(frozen=True)
class TrainVptTobSettings:
    """Learn to predict the seeker's view from the hider's view and its planned path.

    Example: vantage train vpt-tob --data dataset/ --preset compact --minutes 40
    """

    model: Model = "vpt-tob"
    """`vpt-tob`. Baselines: `self-perspective` predicts the hider's own view; `vector-action` is told the path as numbers."""
    data: Path = Path("dataset")
    """The training set."""
    to: Path | None = None
    """Where the weights go, runs/MODEL.safetensors if not said; the model card lies beside them."""
    preset: Literal["paper", "whole-image", "compact"] = "paper"
    """`paper`: the paper's network and recipe. `whole-image`: the same with a bottleneck that sees the whole image. `compact`:
    a smaller network and a recipe for an hour on two CPU cores."""
    start: Path | None = None
    """Begin with these weights (of the same network), not from scratch; the model card names them."""
    minutes: float | None = None
    """Train for this long instead of a number of samples."""
    samples: int | None = None
    """Train on so many samples instead of the preset's number."""
    batch: int | None = None
    """Batch size, instead of the preset's."""
    schedule: Schedule | None = None
    """`steps` multiplies the learning rate by --drop at 25 % and 65 %, `cosine` ends at zero; instead of the preset's."""
    drop: float | None = None
    """Factor of the learning rate: 0.9, 0.5 and 0.1 are the readings of the paper."""
    disc_weight: float | None = None
    """Weight of the robots' pixels, instead of the preset's."""
    judge_weight: float | None = None
    """Weight of the judge's loss, instead of the preset's."""
    head_weight: float | None = None
    """Weight of the caught head's loss, instead of the preset's."""
    workspace: Path | None = None
    """Folder of the checkpoint, of the curves for TensorBoard and of pictures of predictions; runs/MODEL if not said."""
    resume: bool = True
    """Go on from the checkpoint, if the workspace holds one."""
    report_every: int = 16_384
    """Samples between validations."""
    validation: int = 1024
    """Samples of validation games that each of them looks at."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints."""
    threads: int = 0
    """CPU threads; 0 = all cores."""
    resident: Resident = "auto"
    """Keep the training set in the device's memory and render there; `auto`: on a GPU that has twice that memory free."""
    compile: Compile = "auto"
    """Compile the network (a third faster); `auto`: where a compiler is there and the training is long enough."""
    seed: int = 1


def resolve(settings: TrainVptTobSettings) -> Recipe:
    """Return the preset with what the command line changes."""
    names = ("samples", "batch", "schedule", "drop", "disc_weight", "judge_weight", "head_weight")
    changed = {name: value for name in names if (value := getattr(settings, name)) is not None}
    recipe = replace(PRESETS[settings.preset], **changed)
    return replace(recipe, network=replace(recipe.network, caught_head=recipe.head_weight > 0))


def settled(identity: dict[str, Any]) -> dict[str, Any]:
    """Return the identity in a checkpoint; what an earlier version did not write was then as it is by default."""
    return {"model": "vpt-tob", **identity, "recipe": {**asdict(Recipe()), **identity["recipe"]}}


def main(settings: TrainVptTobSettings) -> int:
    """Train; returns the exit code."""
    group = join_group()
    torch.set_num_threads(settings.threads or max(1, (os.cpu_count() or 1) // group.size))
    say = partial(print, flush=True) if group.rank == 0 else lambda *_: None
    recipe, data, model, target = resolve(settings), Dataset(settings.data), settings.model, target_of(settings.model)
    to = settings.to or Path("runs", f"{model}.safetensors")
    workspace = settings.workspace or Path("runs", model)
    compiled, why = to_compile(settings.compile, group.device, recipe.samples, settings.minutes)
    trainer = Trainer(model, recipe, group, compiled, settings.seed)
    size = sum(parameter.numel() for parameter in trainer.network.parameters())
    say(f"{model} `{settings.preset}`, {size:,} parameters, {group.size} x {group.device}, {trainer.precision}; {why}")
    say(f"{settings.data}: episodes {data.manifest['episodes']}, by hider {data.manifest['hiders']}")
    resident = fits(data, group.device) if settings.resident == "auto" else settings.resident == "on"
    if resident:
        say(f"the training set goes to the memory of {group.device} ({needed_bytes(data) / 1e9:.1f} GB) and is rendered there")

    begun_with: dict[str, str] = {}
    if settings.start:
        earlier, earlier_card = load_any(settings.start, (model,))
        if earlier.settings != trainer.network.settings:
            say(f"{settings.start} holds another network than the preset `{settings.preset}`: {earlier.settings}")
            return 1
        trainer.network.load_state_dict(earlier.state_dict())
        begun_with = {settings.start.name: earlier_card.sha256}

    checkpoint = workspace / "checkpoint.pt"
    identity = {"model": model, "recipe": asdict(replace(recipe, samples=0)), "data": data.hash}
    seen, trained, best, best_measures = 0, 0.0, math.inf, dict[str, float]()  # samples, seconds
    if settings.resume and checkpoint.exists():
        saved = torch.load(checkpoint, map_location=group.device, weights_only=True)
        if settled(saved["identity"]) != identity:
            say(f"{checkpoint} is of another recipe or training set: choose another --workspace, or --no-resume")
            return 1
        trainer.restore(saved["trainer"])
        seen, trained, best, best_measures = saved["seen"], saved["trained"], saved["best"], saved["best_measures"]
        say(f"going on after {seen:,} samples, {trained / 60:.1f} minutes")
    board = Board(workspace, seen) if group.rank == 0 else None

    held = data.draw("validation", settings.validation, np.random.default_rng(0), recipe.from_start, symmetries=1)
    vectors = model == "vector-action"

    def drawn() -> Iterator[Samples]:
        number = seen // recipe.batch + group.rank
        while True:  # a batch depends on its number alone, so that a resumed run goes on as if never stopped
            generator = np.random.default_rng([settings.seed, number])
            yield data.draw("train", recipe.batch, generator, recipe.from_start, symmetries=recipe.symmetries)
            number += group.size

    def batches() -> Iterator[Tensors]:
        """Whatever is learnt from comes from here, on the device."""
        if resident:
            there = DeviceDataset(data, group.device)
            for samples in drawn():
                yield there.render(samples, target, vectors)
        else:
            for batch in prefetch(lambda: (data.render(samples, target, vectors) for samples in drawn())):
                yield tensors_of(batch, group.device)

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
        card.training = {
            **asdict(recipe),
            "samples": seen,
            "best after": seen,
            "minutes": trained / 60,
            "device": str(group.device),
            "seed": settings.seed,
            "target": f"the {target}'s view",
        }
        card.training.pop("network")
        card.notes, card.inputs = notes_of(recipe), begun_with
        if target == "hider":
            card.notes = ["A baseline: predicts the hider's own later view, not the seeker's.", *card.notes]
        return card

    stream = batches()
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
            measures, (batch, views) = trainer.validate(data.batches(held, 64, target, vectors))
            panel = draw_panel(workspace / "latest.png", batch, views, target)
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
                board.picture("predictions", panel, seen)
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

    sys.exit(main(tyro.cli(TrainVptTobSettings)))
