"""One run of a training, whichever network learns: how far it has come, its checkpoint, its weights, and what people read."""

from __future__ import annotations

import io
import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any, Literal, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.best_weights import BestWeights
from learning.board import Board
from learning.dataset import Dataset, Samples
from learning.group import Group
from learning.recipe import CaughtRecipe, Recipe, VpnRecipe
from learning.training_identity import OtherTraining, differences, digest_of
from learning.training_settings import Place, SharedSettings
from vantage.errors import UserError, explain
from vantage.log import source_commit
from vantage.networks.weights import ModelCard, Network, card_of
from vantage.output import remove_abandoned, write_complete
from vantage.stopping import stop_deferred, stop_requested

Item = TypeVar("Item")


def training_samples(
    data: Dataset, recipe: Recipe | CaughtRecipe | VpnRecipe, seed: int, numbers: Iterable[int]
) -> Iterator[Samples]:
    """Yield batches; each depends on its number alone, so that a resumed run goes on as if never stopped."""
    for number in numbers:
        generator = np.random.default_rng([seed, number])
        yield data.draw("train", recipe.batch, generator, recipe.from_start, symmetries=recipe.symmetries)


class NotWritten(UserError):
    """A checkpoint or weights could not be written; the text says which are kept."""


class Stopped(Exception):
    """A signal has asked this training to stop; raised between two steps, or between two batches of a validation."""


class TrainingRun:
    """How far a training has come: counted, kept in the checkpoint of a workspace, and shown in lines and curves.

    `train` is the loop. The time that validations and checkpoints take is not counted as training.

    Args:
        place: of weights, checkpoint and curves.
        identity: see `identity_of`; of plain types and tuples.
        group: its first process alone reports, writes and prints.
        total: samples to learn from.
        minutes: learn for so long instead.
        report_every: samples between two reports.
        checkpoint_minutes: between two checkpoints.
        unit: of what is learnt from.
        force: replace checkpoint and weights of another training.

    Attributes:
        seen: samples learnt from, by all processes.
        trained: s.
        progress: 0..1, or more, of the whole training; as the first process has it.
        best: the lowest validation loss; inf before the first.
        best_measures: all that was measured then.
    """

    def __init__(
        self,
        place: Place,
        identity: Mapping[str, Any],
        group: Group,
        total: int,
        minutes: float | None,
        report_every: int,
        checkpoint_minutes: float = 0.0,
        unit: Literal["samples", "images"] = "samples",
        force: bool = False,
    ) -> None:
        self.weights, self.checkpoint = BestWeights(place.weights, digest_of(identity)), place.workspace / "checkpoint.pt"
        self.identity, self.group, self.unit, self.force = identity, group, unit, force
        self.total, self.minutes, self.report_every, self.checkpoint_minutes = total, minutes, report_every, checkpoint_minutes
        self.seen, self.trained, self.progress = 0, 0.0, 0.0
        self.best, self.best_measures = math.inf, dict[str, float]()
        self._stopping = False
        self._board: Board | None = None
        self._loss = torch.zeros((), device=group.device)  # its sum over the samples since the last report
        self._validated = 0  # `seen` at the last validation
        self._written: float | None = None  # s, of `trained`; None = no checkpoint yet
        self._begin_report()

    def _begin_report(self) -> None:
        self._loss.zero_()
        self._reported_seen, self._reported_trained, self._clock = self.seen, self.trained, time.monotonic()

    @classmethod
    def of(
        cls, settings: SharedSettings, place: Place, identity: Mapping[str, Any], group: Group, total: int, **more: Any
    ) -> TrainingRun:
        """Return the run that the settings ask for."""
        paces = (total, settings.minutes, settings.report_every, settings.checkpoint_minutes)
        return cls(place, identity, group, *paces, force=settings.force, **more)

    def say(self, text: str) -> None:
        """Print a line."""
        if self.group.rank == 0:
            print(text, flush=True)

    def introduce(self, name: str, data: Dataset, network: nn.Module, how: str) -> None:
        """Print what learns from what."""
        size = sum(parameter.numel() for parameter in network.parameters())
        on = f"{self.group.device}" if self.group.size == 1 else f"{self.group.size} x {self.group.device}"
        self.say(f"{name}, seed {self.identity['seed']}, {size:,} parameters, {on}, {how}")
        splits, hiders = (
            ", ".join(f"{count:,} {key}" for key, count in data.manifest[what].items()) for what in ("episodes", "hiders")
        )
        self.say(f"{data.folder}: games {splits}; by hider {hiders}")

    def resume(self, go_on: bool = True) -> dict[str, Any] | None:
        """Take up what the checkpoint counted and return it whole, with the state that was written into it; None without one.

        Weights that belong to the checkpoint and are gone or damaged are written again. The card is completed where a training
        is over but was killed before `finish`.

        Args:
            go_on: else begin again, and only see to it that nothing of another training is in the way.

        Raises:
            OtherTraining: checkpoint or weights are of another identity.
            UserError: the checkpoint cannot be read, is gone, or has seen more than is asked for.
        """
        for folder in {self.checkpoint.parent, self.weights.path.parent}:
            remove_abandoned(folder)
        saved = self._read_checkpoint()
        if saved is not None and (differing := differences(saved["identity"], self.identity)):
            if not self.force:
                raise OtherTraining(
                    f"{self.checkpoint} is of another training ({differing}): choose another --to, or --force to replace it"
                )
            saved = None
        if saved is not None:
            self.weights.restore(saved["best weights"])
        if not self.force:
            self.weights.refuse_to_overwrite(known=saved is not None or not go_on)
        if saved is None or not go_on:
            self.weights.card = None
            return None
        self.seen, self.trained, self._validated = saved["seen"], saved["trained"], saved["validated"]
        self.best, self.best_measures = saved["best"], saved["best_measures"]
        self._written = self.trained
        if self._own_progress >= 1.0 and saved["asked"] != self._asked:
            raise UserError(
                f"{self.weights.path} has learnt from {self._so_far} already, all that is asked for or more: choose another --to"
            )
        if self.group.rank == 0 and (mended := self.weights.mend(self._came_to, self.is_over)):
            self.say(mended)
        if self.is_over:
            self.say(f"nothing left to train: {self.weights.path} has learnt from {self._so_far}; ask for more, and it goes on")
        else:
            self.say(f"going on after {self._so_far}")
        return saved

    def _read_checkpoint(self) -> dict[str, Any] | None:
        if not self.checkpoint.exists():
            return None
        try:
            saved = torch.load(self.checkpoint, map_location=self.group.device, weights_only=True)
            if not isinstance(saved, dict) or not isinstance(saved.get("identity"), dict):
                raise ValueError("it holds something else")
        except Exception as error:  # of torch, pickle and zipfile: anything
            if self.force:
                return None
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise UserError(f"{self.checkpoint} cannot be read ({reason}): remove it, or --force to begin again") from None
        return saved

    @property
    def _asked(self) -> list[Any]:
        return [self.total, None] if self.minutes is None else [None, self.minutes]

    @property
    def _so_far(self) -> str:
        return f"{self.seen:,} {self.unit} in {self.trained / 60:.1f} minutes"

    @property
    def is_over(self) -> bool:
        """Whether all that is asked for is learnt, validated and saved."""
        return self._own_progress >= 1.0 and self._validated == self.seen

    def begin(self) -> None:
        """Open the curves and start the clock, before the first step."""
        if self.group.rank == 0:
            self._board = Board(self.checkpoint.parent, self.seen)
        self._begin_report()
        self._update_progress()

    def batch_numbers(self, batch: int) -> Iterator[int]:
        """Return the numbers of the batches that this process learns from, from here on."""
        return itertools.count(self.seen // batch + self.group.rank, self.group.size)

    def train(
        self,
        step: Callable[[], tuple[int, Tensor]],
        validate: Callable[[], dict[str, float]],
        network: Network,
        card: Callable[[], ModelCard],
        state: Callable[[], Mapping[str, Any]],
        curves: Callable[[], Mapping[str, float]] = dict,
    ) -> None:
        """Learn until the end; between two steps validate, keep the best weights, and write checkpoints.

        Args:
            step: learn from a batch; returns the samples of all processes, and their mean loss.
            validate: measure; `loss` decides which weights are the best.
            network: to be saved.
            card: describes it as it is now.
            state: of what learns, for the checkpoint.
            curves: points of further curves.

        Raises:
            KeyboardInterrupt: a signal came: the running step is finished and the checkpoint written.
            NotWritten: the disk does not take checkpoint or weights; what was written before is kept.
        """
        with stop_deferred():
            self.begin()
            try:
                while True:
                    better = False
                    if self.report_is_due:
                        measures = validate()
                        self._validated = self.seen
                        if better := self.keep_if_best(measures):
                            self.weights.keep(network, card())
                        self.report(measures, better, {**curves(), f"{self.unit} a second": self.speed})
                    if better or self.checkpoint_is_due:  # the best weights are in the checkpoint, too
                        self.write_checkpoint(state())
                    if self.progress >= 1.0:
                        break
                    if self._stopping:
                        raise Stopped
                    self.count(*step())
            except Stopped:
                if self.group.rank:
                    raise SystemExit(1) from None  # the first process says it
                if self.seen:
                    self.write_checkpoint(state())
                text = f"the checkpoint after {self._so_far} is kept; the same command goes on" if self.seen else ""
                raise KeyboardInterrupt(text) from None
            except OSError as error:
                kept = "the checkpoint before it is kept" if self._written is not None else "nothing is kept"
                raise NotWritten(f"{explain(error) or error}. The training ends after {self._so_far}; {kept}") from error

    def interruptible(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield items; between two of them a signal ends it, but where other processes would wait for this one.

        Raises:
            Stopped: see `stop_requested`.
        """
        for item in items:
            if stop_requested() and self.group.size == 1:
                raise Stopped
            yield item

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

    @property
    def _own_progress(self) -> float:
        return self.trained / (60 * self.minutes) if self.minutes else self.seen / self.total

    def _update_progress(self) -> None:
        self.progress, self._stopping = self.group.agree(self._own_progress, stop_requested())

    @property
    def report_is_due(self) -> bool:
        """Whether it is time to validate and report: every so many samples, and at the end."""
        new = self.seen - self._validated
        return self.group.rank == 0 and new > 0 and (new >= self.report_every or self.progress >= 1.0)

    @property
    def checkpoint_is_due(self) -> bool:
        """Whether it is time to write the checkpoint: after the first step, every so many minutes, and at the end."""
        if self.group.rank or not self.seen:
            return False
        new = math.inf if self._written is None else self.trained - self._written
        return new > 0 and (new >= 60 * self.checkpoint_minutes or self.progress >= 1.0)

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

    @property
    def _came_to(self) -> dict[str, Any]:
        return {"samples" if self.unit == "samples" else "images seen": self.seen, "minutes": self.trained / 60}

    def report(self, measures: Mapping[str, float], saved: bool, curves: Mapping[str, float] | None = None) -> None:
        """Print a line of what was learnt since the last report, and add a point to each curve.

        Args:
            measures: of the validation.
            saved: whether the weights were.
            curves: points of further curves.
        """
        pace = f"{self.speed:4.0f}/s  {self.minutes_left:4.1f} min left"
        learnt = self.seen - self._reported_seen
        loss = {"training/loss": self._loss.item() / learnt} if learnt else {}
        parts = "  ".join(f"{name} {value:.4f}" for name, value in measures.items())
        shown = "".join(f"  loss {value:.4f}" for value in loss.values())
        self.say(
            f"{100 * self.progress:5.1f} %  {self.seen:>9,} {self.unit}  {pace}{shown}"
            f"  validation: {parts}{'  * saved' if saved else ''}"
        )
        if self._board:
            validation = {f"validation/{name}": value for name, value in measures.items()}
            self._board.curves({**validation, **loss, **(curves or {})}, self.seen)
        self._begin_report()

    def show(self, name: str, picture: NDArray[np.uint8]) -> None:
        """Add a picture, uint8 [height, width, 3], to the curves."""
        if self._board:
            self._board.picture(name, picture, self.seen)

    def write_checkpoint(self, state: Mapping[str, Any]) -> None:
        """Write the checkpoint, with this state of what learns and the best weights so far; if that fails, the one before it
        is kept."""
        content = {
            "identity": self.identity,
            **state,
            "seen": self.seen,
            "trained": self.trained,
            "validated": self._validated,
            "asked": self._asked,
            "best": self.best,
            "best_measures": self.best_measures,
            "best weights": self.weights.state(),
        }
        buffer = io.BytesIO()  # torch's own writer hides why a disk refuses
        torch.save(content, buffer)
        write_complete(self.checkpoint, buffer.getvalue())
        self._written, self._clock = self.trained, time.monotonic()

    def model_card(
        self, network: Network, preset: str, data: Dataset, recipe: Recipe | CaughtRecipe | VpnRecipe, notes: list[str]
    ) -> ModelCard:
        """Return a card of the best weights so far, without inputs."""
        card = card_of(network)
        card.preset, card.commit, card.metrics, card.notes = preset, source_commit(), dict(self.best_measures), notes
        card.data = {key: data.manifest[key] for key in ("hash", "episodes", "hiders", "seekers", "layouts", "horizons")}
        run = {**self._came_to, "best after": self.seen, "device": str(self.group.device), "seed": self.identity["seed"]}
        card.training = {key: value for key, value in asdict(recipe).items() if key != "network"} | run
        return card

    def finish(self) -> None:
        """Write into the card what the training came to, and print it; the last call of a run.

        Raises:
            UserError: no validation found weights worth keeping.
        """
        if self.group.rank == 0:
            if self.weights.card is None:
                raise UserError(
                    f"after {self._so_far} the validation loss was never a number: no weights were written; try a lower rate"
                )
            self.weights.write(self._came_to)
            best = ", ".join(f"{name} {value:.4f}" for name, value in self.best_measures.items())
            self.say(f"best validation: {best}; weights in {self.weights.path}")
        if self._board:
            self._board.close()
