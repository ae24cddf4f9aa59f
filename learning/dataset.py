"""The training set: a folder with tables of episodes, steps and plans, and every state image, compressed, in one file.

    manifest.json   schema version, commit, logs with their hashes, counts, hash of everything below
    episodes.npy    EPISODE, one row an episode
    steps.npy       STEP, one row a recorded step: both true poses, and which plan was in force
    plans.npy       PLAN, one row a plan the hider followed
    positions.npy   float32 [n, 3]: planned x, y (m), heading (rad), one plan after the other
    images.lz4      lz4 blocks of 128 x 128 palette indices: of step s, the hider's view is image 2 s, the seeker's 2 s + 1
    offsets.npy     int64 [images + 1]: where each lies

A hider, seeker or layout whose name is longer than its field in episodes.npy stands there as a digest (`key_of`); its whole name
is in the manifest.

A sample is (episode, t0, ti): I_H at t0, F and T of the plan in force at t0 from t0 to ti, the seeker's view at ti. After a
catch the game is frozen: the view is that of the catch and v = 1 (reading of the paper, row 6). F and T always reach to ti.
"""

from __future__ import annotations

import hashlib
import json
import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import lz4.block
import numpy as np
from numpy.typing import NDArray

from learning.methods.method import Questions
from learning.splits import SPLITS, Split
from schemas import STATE_IMAGE_SIZE
from vantage.errors import UserError
from vantage.networks.action_vector import VECTOR_LENGTH, render_vectors
from vantage.networks.inputs import CHANNELS, render_inputs, render_targets

SCHEMA_VERSION = 1
DEFAULT_DATASET = Path("data/dataset")
"""Where `vantage gather` and `vantage convert` leave a training set, and everything else looks for one."""

_POSE = [("x", "<f4"), ("y", "<f4"), ("heading", "<f4")]
EPISODE = np.dtype(
    [
        ("id", "<u8"),
        ("seed", "<u8"),
        ("hider", "S32"),  # policy that drove it, see `key_of`
        ("seeker", "S16"),  # preset, see `key_of`
        ("layout", "S64"),  # see `key_of`
        ("first_step", "<i8"),  # row in steps.npy
        ("steps", "<i4"),  # recorded steps, step 0 included
        ("caught_step", "<i4"),  # -1: survived
        ("horizon", "<i4"),  # T of the rules
        ("split", "u1"),  # index into SPLITS
    ]
)
STEP = np.dtype([("hider", _POSE), ("seeker", _POSE), ("plan", "<i8")])
PLAN = np.dtype([("start", "<i4"), ("first_position", "<i8"), ("positions", "<i4")])

Target = Literal["seeker", "hider"]
"""Whose view at ti is to be predicted."""

_SIZE = STATE_IMAGE_SIZE
_IMAGE_BYTES = _SIZE * _SIZE


def key_of(name: str, field: str) -> bytes:
    """Return what stands for a name in a field of EPISODE: its UTF-8, or a digest of it where that does not fit."""
    width = EPISODE[field].itemsize
    encoded = name.encode()
    if len(encoded) <= width and b"\0" not in encoded:
        return encoded
    return hashlib.sha256(encoded).hexdigest()[:width].encode()


class UnusableDataset(UserError, ValueError):
    """The folder is not a training set, or one of another version."""


@dataclass(frozen=True)
class Samples:
    """Which samples, as arrays [B]."""

    episode: NDArray[np.int64]
    start: NDArray[np.int64]  # t0
    horizon: NDArray[np.int64]  # ti - t0
    symmetry: NDArray[np.int64]  # of the square, 0..7
    caught: NDArray[np.bool_]  # v at ti

    def __len__(self) -> int:
        return len(self.episode)

    def part(self, first: int, stop: int) -> Samples:
        """Return samples first .. stop - 1."""
        cut = slice(first, stop)
        return Samples(self.episode[cut], self.start[cut], self.horizon[cut], self.symmetry[cut], self.caught[cut])


@dataclass(frozen=True)
class Batch:
    """Rendered samples."""

    inputs: NDArray[np.uint8]  # [B, 128, 128, 7]
    targets: NDArray[np.uint8]  # [B, 128, 128, 3]
    discs: NDArray[np.bool_]  # [B, 128, 128]: target pixels that show a robot
    vectors: NDArray[np.float32]  # [B, 121], or [B, 0] where they were not asked for
    caught: NDArray[np.bool_]  # [B]
    samples: Samples


class Dataset:
    """A training set on disk, opened for reading.

    Raises:
        UnusableDataset: it is missing, broken, or of another version.
    """

    def __init__(self, folder: Path) -> None:
        try:
            self.manifest: dict[str, Any] = json.loads((folder / "manifest.json").read_text())
        except FileNotFoundError:
            raise UnusableDataset(
                f"{folder} holds no training set: make one with `vantage convert logs/ --to {folder}`"
            ) from None
        if self.manifest.get("schema_version") != SCHEMA_VERSION:
            version = self.manifest.get("schema_version")
            raise UnusableDataset(f"{folder} is of version {version}, wanted is {SCHEMA_VERSION}: convert the logs again")
        self.folder = folder
        try:
            self.episodes = np.load(folder / "episodes.npy")
            self.steps = np.load(folder / "steps.npy")
            self.plans = np.load(folder / "plans.npy")
            self.positions = np.load(folder / "positions.npy")
            self._offsets = np.load(folder / "offsets.npy")
            self._images = np.memmap(folder / "images.lz4", np.uint8, "r")
        except (OSError, EOFError, ValueError) as error:
            raise UnusableDataset(f"{folder} is broken ({error}): convert the logs again") from None
        self._bytes = memoryview(self._images)  # type: ignore[arg-type]

    def name_of(self, episode: int, field: Literal["hider", "seeker", "layout"]) -> str:
        """Return the whole name of an episode's hider, seeker or layout, whatever its length."""
        key = bytes(self.episodes[field][episode])
        known = {key_of(name, field): name for name in self.manifest[f"{field}s"]}
        return known.get(key) or key.decode(errors="replace")  # sets of earlier versions cut long names

    @property
    def hash(self) -> str:
        """Hash of the data, as the manifest has it."""
        return str(self.manifest["hash"])

    def image(self, step: int, robot: int) -> bytes:
        """Return the 128 * 128 palette indices of a view: `step` a row of steps.npy, `robot` 0 hider or 1 seeker."""
        number = 2 * step + robot
        return lz4.block.decompress(
            self._bytes[self._offsets[number] : self._offsets[number + 1]], uncompressed_size=_IMAGE_BYTES
        )

    def of_split(self, split: Split) -> NDArray[np.int64]:
        """Return the rows of the episodes of a split."""
        return np.flatnonzero(self.episodes["split"] == SPLITS.index(split))

    def longest_horizon(self, episode: NDArray[np.int64], start: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many steps past `start` the plan in force reaches and the outcome is known; -1 where no plan is in force."""
        rows = self.episodes[episode]
        plan = self.steps["plan"][rows["first_step"] + start]
        plans = self.plans[plan]
        planned = plans["start"] + plans["positions"] - 1 - start
        known = np.where(rows["caught_step"] >= 0, rows["horizon"], rows["steps"] - 1) - start
        longest = np.minimum(np.minimum(planned, known), rows["horizon"] - 1)
        return np.where(plan < 0, -1, longest).astype(np.int64)

    def draw(
        self,
        split: Split,
        count: int,
        generator: np.random.Generator,
        from_start: float = 0.5,
        horizon_limit: int | None = None,
        symmetries: int = 8,
    ) -> Samples:
        """Draw samples: an episode uniformly, t0, then the horizon uniformly from 0 to T - 1 as far as the plan reaches.

        Args:
            from_start: share of samples with t0 = 0; for the rest any step before the catch is t0.
            horizon_limit: horizons stay below it; None = T.
            symmetries: 8 for flips and quarter turns, 4 for quarter turns, 1 for none.

        Raises:
            UnusableDataset: the split is empty.
        """
        rows = self.of_split(split)
        if len(rows) == 0:
            raise UnusableDataset(f"{self.folder} has no {split} episodes: gather more")
        episode = rows[generator.integers(len(rows), size=count)]
        chosen = self.episodes[episode]
        playing = np.where(chosen["caught_step"] >= 0, chosen["caught_step"], chosen["steps"] - 1).astype(np.int64)
        start = np.where(generator.random(count) < from_start, 0, (generator.random(count) * playing).astype(np.int64))
        longest = self.longest_horizon(episode, start)
        while (missing := np.flatnonzero(longest < 0)).size:  # no plan in force there
            start[missing] = (generator.random(missing.size) * np.maximum(playing[missing], 1)).astype(np.int64)
            longest[missing] = self.longest_horizon(episode[missing], start[missing])
        if horizon_limit is not None:
            longest = np.minimum(longest, horizon_limit - 1)
        horizon = (generator.random(count) * (longest + 1)).astype(np.int64)
        symmetry = generator.integers(symmetries, size=count)
        return Samples(episode, start, horizon, symmetry, self.caught(episode, start + horizon))

    def caught(self, episode: NDArray[np.int64], step: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return v: whether the hider has been caught by that step."""
        caught_step = self.episodes["caught_step"][episode]
        return (caught_step >= 0) & (caught_step <= step)

    def render(self, samples: Samples, target: Target = "seeker", vectors: bool = False) -> Batch:
        """Render samples into the arrays that the networks are shown.

        Args:
            target: whose view at ti to predict; either is frozen at the catch.
            vectors: render the plan as action vectors, too.
        """
        count = len(samples)
        rows = self.episodes[samples.episode]
        now = rows["first_step"] + samples.start
        end = samples.start + samples.horizon
        end = rows["first_step"] + np.where(rows["caught_step"] >= 0, np.minimum(end, rows["caught_step"]), end)
        views = np.empty((2, count, _SIZE, _SIZE), np.uint8)
        for b in range(count):
            views[0, b] = np.frombuffer(self.image(int(now[b]), 0), np.uint8).reshape(_SIZE, _SIZE)
            views[1, b] = np.frombuffer(self.image(int(end[b]), int(target == "seeker")), np.uint8).reshape(_SIZE, _SIZE)
        plans = self.plans[self.steps["plan"][now]]
        first = plans["first_position"] + samples.start - plans["start"]
        inputs = np.empty((count, _SIZE, _SIZE, CHANNELS), np.uint8)
        targets = np.empty((count, _SIZE, _SIZE, 3), np.uint8)
        discs = np.empty((count, _SIZE, _SIZE), np.bool_)
        render_inputs(views[0], np.arange(count), self.positions, first, samples.horizon, samples.symmetry, inputs)
        render_targets(views[1], samples.symmetry, targets, discs)
        actions = np.empty((count, VECTOR_LENGTH if vectors else 0), np.float32)
        if vectors:
            render_vectors(self.positions, first, samples.horizon, samples.symmetry, actions)
        return Batch(inputs, targets, discs, actions, samples.caught, samples)

    def questions(self, samples: Samples) -> Questions:
        """Return what `render` shows of samples, as questions for a method; symmetries are not applied."""
        now = self.episodes["first_step"][samples.episode] + samples.start
        seen, view_of = np.unique(now, return_inverse=True)
        views = np.empty((len(seen), _SIZE, _SIZE), np.uint8)
        for number, step in enumerate(seen):
            views[number] = np.frombuffer(self.image(int(step), 0), np.uint8).reshape(_SIZE, _SIZE)
        plans = self.plans[self.steps["plan"][now]]
        first = plans["first_position"] + samples.start - plans["start"]
        last = plans["first_position"] + plans["positions"] - 1
        return Questions(views, view_of.astype(np.int64), self.positions, first, last, samples.horizon)

    def batches(self, samples: Samples, size: int, target: Target = "seeker", vectors: bool = False) -> Iterator[Batch]:
        """Render samples batch by batch, the last one smaller where `size` does not divide them."""
        for first in range(0, len(samples), size):
            yield self.render(samples.part(first, first + size), target, vectors)


Item = TypeVar("Item")


def prefetch(make: Callable[[], Iterator[Item]], ahead: int = 4) -> Iterator[Item]:
    """Yield what `make()` yields, made up to `ahead` items in advance by one thread (the kernels release the GIL)."""
    ready: queue.Queue[Item | BaseException | None] = queue.Queue(ahead)
    stopped = threading.Event()

    def offer(item: Item | BaseException | None) -> None:
        while not stopped.is_set():
            try:
                ready.put(item, timeout=0.2)
                return
            except queue.Full:
                continue

    def fill() -> None:
        try:
            for item in make():
                offer(item)
                if stopped.is_set():
                    return
            offer(None)
        except BaseException as error:
            offer(error)

    thread = threading.Thread(target=fill, name="prefetch", daemon=True)
    thread.start()
    try:
        while (item := ready.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        stopped.set()
        thread.join()
