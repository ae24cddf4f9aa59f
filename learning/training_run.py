"""One run of a training, whichever network learns: how far it has come, its checkpoint, and what people are told."""

from __future__ import annotations

import itertools
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.board import Board
from learning.dataset import Dataset, Samples
from learning.group import Group
from learning.recipe import CaughtRecipe, Recipe, VpnRecipe
from learning.training_settings import TrainingSettings
from vantage.errors import UserError
from vantage.log import source_commit
from vantage.networks.weights import ModelCard, Network, card_of


def training_samples(
    data: Dataset, recipe: Recipe | CaughtRecipe | VpnRecipe, seed: int, numbers: Iterable[int]
) -> Iterator[Samples]:
    """Yield batches; each depends on its number alone, so that a resumed run goes on as if never stopped."""
    for number in numbers:
        generator = np.random.default_rng([seed, number])
        yield data.draw("train", recipe.batch, generator, recipe.from_start, symmetries=recipe.symmetries)


class OtherTraining(UserError, ValueError):
    """The workspace holds the checkpoint of another training; the text says what to do."""


class TrainingRun:
    """How far a training has come: counted, kept in the checkpoint of a workspace, and told in lines and curves.

    The loop counts each step; where `report_is_due` it validates and reports, where `checkpoint_is_due` it writes the checkpoint.
    The time that those two take is not counted as training.

    Args:
        workspace: folder of checkpoint and curves.
        identity: what a checkpoint must have in common with this training to be gone on from; of plain types and tuples.
        group: its first process alone reports, writes and prints.
        total: samples to learn from.
        minutes: learn for so long instead.
        report_every: samples between two reports.
        checkpoint_minutes: between two checkpoints.
        unit: what the samples are called.

    Attributes:
        seen: samples learnt from, by all processes.
        trained: s.
        progress: 0..1, or more, of the whole training; as the first process has it.
        best: the lowest validation loss; inf before the first.
        best_measures: all that was measured then.
    """

    def __init__(
        self,
        workspace: Path,
        identity: Mapping[str, Any],
        group: Group,
        total: int,
        minutes: float | None,
        report_every: int,
        checkpoint_minutes: float = 0.0,
        unit: Literal["samples", "images"] = "samples",
    ) -> None:
        self.checkpoint = workspace / "checkpoint.pt"
        self.identity, self.group, self.unit = identity, group, unit
        self.total, self.minutes, self.report_every, self.checkpoint_minutes = total, minutes, report_every, checkpoint_minutes
        self.seen, self.trained, self.progress = 0, 0.0, 0.0
        self.best, self.best_measures = math.inf, dict[str, float]()
        self._board: Board | None = None
        self._loss = torch.zeros((), device=group.device)  # its sum over the samples since the last report
        self._written = 0.0  # s, of `trained`
        self._begin_report()

    def _begin_report(self) -> None:
        self._loss.zero_()
        self._reported_seen, self._reported_trained, self._clock = self.seen, self.trained, time.monotonic()

    @classmethod
    def of(cls, settings: TrainingSettings, identity: Mapping[str, Any], group: Group, total: int) -> TrainingRun:
        """Return the run that the settings ask for."""
        paces = (total, settings.minutes, settings.report_every, settings.checkpoint_minutes)
        return cls(settings.folder, identity, group, *paces)

    def say(self, text: str) -> None:
        """Print a line."""
        if self.group.rank == 0:
            print(text, flush=True)

    def introduce(self, settings: TrainingSettings, data: Dataset, network: nn.Module, how: str) -> None:
        """Say what learns from what."""
        size = sum(parameter.numel() for parameter in network.parameters())
        on = f"{self.group.size} x {self.group.device}"
        self.say(f"{settings.model} `{settings.preset}`, {size:,} parameters, {on}, {how}")
        self.say(f"{settings.data}: episodes {data.manifest['episodes']}, by hider {data.manifest['hiders']}")

    def refuse(self, why: object) -> int:
        """Print on stderr why this training does not begin; returns the exit code."""
        if self.group.rank == 0:
            print(why, file=sys.stderr, flush=True)
        return 1

    def resume(
        self, distinct_by: str = "recipe or training set", settled: Callable[[dict[str, Any]], Mapping[str, Any]] = dict
    ) -> dict[str, Any] | None:
        """Take up what the checkpoint counted and return it whole, with the state that was written into it; None without one.

        Args:
            distinct_by: what makes another training, for people.
            settled: completes an identity that an earlier version wrote.

        Raises:
            OtherTraining: it is of another identity.
        """
        if not self.checkpoint.exists():
            return None
        saved = torch.load(self.checkpoint, map_location=self.group.device, weights_only=True)
        if settled(saved["identity"]) != self.identity:
            raise OtherTraining(f"{self.checkpoint} is of another {distinct_by}: choose another --workspace, or --no-resume")
        self.seen, self.trained = saved["seen"], saved["trained"]
        self.best, self.best_measures = saved["best"], saved["best_measures"]
        self.say(f"going on after {self.seen:,} {self.unit}, {self.trained / 60:.1f} minutes")
        return saved

    def begin(self) -> None:
        """Open the curves and start the clock, before the first step."""
        if self.group.rank == 0:
            self._board = Board(self.checkpoint.parent, self.seen)
        self._written = self.trained
        self._begin_report()
        self._update_progress()

    def batch_numbers(self, batch: int) -> Iterator[int]:
        """Return the numbers of the batches that this process learns from, from here on."""
        return itertools.count(self.seen // batch + self.group.rank, self.group.size)

    def count(self, samples: int, loss: Tensor) -> None:
        """Count a step on so many samples, and the time since the one before it.

        Args:
            samples: of all processes together.
            loss: their mean.
        """
        self._loss += loss * samples
        self.seen += samples
        now = time.monotonic()
        self.trained, self._clock = self.trained + now - self._clock, now
        self._update_progress()

    def _update_progress(self) -> None:
        mine = self.trained / (60 * self.minutes) if self.minutes else self.seen / self.total
        self.progress = self.group.from_first(mine)

    @property
    def report_is_due(self) -> bool:
        """Whether it is time to validate and report: every so many samples, and at the end."""
        return self.group.rank == 0 and (self.seen - self._reported_seen >= self.report_every or self.progress >= 1.0)

    @property
    def checkpoint_is_due(self) -> bool:
        """Whether it is time to write the checkpoint: every so many minutes, and at the end."""
        due = self.trained - self._written >= 60 * self.checkpoint_minutes or self.progress >= 1.0
        return self.group.rank == 0 and due

    @property
    def speed(self) -> float:
        """Samples a second since the last report."""
        return (self.seen - self._reported_seen) / max(self.trained - self._reported_trained, 1e-9)

    @property
    def minutes_left(self) -> float:
        """Minutes to the end of the training, should it go on as fast as before."""
        return max(self.trained * (1 / max(self.progress, 1e-9) - 1) / 60, 0.0)

    def keep_if_best(self, measures: dict[str, float]) -> bool:
        """Keep what a validation measured if its `loss` is lower than that of all before it. Returns whether it is."""
        better = measures["loss"] < self.best  # not where it is NaN
        if better:
            self.best, self.best_measures = measures["loss"], measures
        return better

    def report(
        self, measures: Mapping[str, float], saved: bool, curves: Mapping[str, float] | None = None, pace: str | None = None
    ) -> None:
        """Print a line of what was learnt since the last report, and add a point to each curve.

        Args:
            measures: of the validation.
            saved: whether the weights were.
            curves: points of further curves.
            pace: for people; speed and time left if not said.
        """
        pace = pace or f"{self.speed:4.0f}/s  {self.minutes_left:4.0f} min left"
        loss = self._loss.item() / (self.seen - self._reported_seen)
        parts = "  ".join(f"{name} {value:.4f}" for name, value in measures.items())
        self.say(
            f"{100 * self.progress:5.1f} %  {self.seen:>9,} {self.unit}  {pace}  loss {loss:.4f}"
            f"  validation: {parts}{'  * saved' if saved else ''}"
        )
        if self._board:
            validation = {f"validation/{name}": value for name, value in measures.items()}
            self._board.curves({**validation, "training/loss": loss, **(curves or {})}, self.seen)
        self._begin_report()

    def show(self, name: str, picture: NDArray[np.uint8]) -> None:
        """Add a picture, uint8 [height, width, 3], to the curves."""
        if self._board:
            self._board.picture(name, picture, self.seen)

    def write_checkpoint(self, state: Mapping[str, Any]) -> None:
        """Write the checkpoint, with this state of what learns; one that is interrupted leaves the checkpoint before it."""
        counts = {"seen": self.seen, "trained": self.trained, "best": self.best, "best_measures": self.best_measures}
        self.checkpoint.parent.mkdir(parents=True, exist_ok=True)
        partial = self.checkpoint.with_suffix(".partial")
        torch.save({"identity": self.identity, **state, **counts}, partial)
        os.replace(partial, self.checkpoint)
        self._written, self._clock = self.trained, time.monotonic()

    def model_card(
        self,
        network: Network,
        preset: str,
        data: Dataset,
        recipe: Recipe | CaughtRecipe | VpnRecipe,
        counts: Mapping[str, int],
        seed: int,
    ) -> ModelCard:
        """Return a card of the best weights so far, without notes and inputs.

        Args:
            counts: how `seen` stands in it.
        """
        card = card_of(network)
        card.preset, card.commit, card.metrics = preset, source_commit(), self.best_measures
        card.data = {key: data.manifest[key] for key in ("hash", "episodes", "hiders", "seekers", "layouts", "horizons")}
        run = {**counts, "minutes": self.trained / 60, "device": str(self.group.device), "seed": seed}
        card.training = {key: value for key, value in asdict(recipe).items() if key != "network"} | run
        return card

    def finish(self, weights: Path) -> None:
        """Say what it came to; the last call."""
        self.say(f"best validation: {self.best_measures}; weights in {weights}")
        if self._board:
            self._board.close()
        self.group.leave()
