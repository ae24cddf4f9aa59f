"""The tables of a training set: put together from those of its logs, and cut to the wanted sizes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.dataset import UnusableDataset, key_of
from learning.splits import SPLITS

Sizes = tuple[int, int, int]
"""Games of the training, validation and test split."""


class TooFewGames(UnusableDataset):
    """Fewer games can serve than are wanted; `lacking` holds how many, hider -> by split."""

    def __init__(self, lacking: dict[str, Sizes]) -> None:
        self.lacking = lacking
        counts = (f"{by_split(sizes)} of `{hider}`" for hider, sizes in lacking.items())
        super().__init__(f"the logs hold too few games, lacking are {', '.join(counts)}: gather more")


def by_split(sizes: Iterable[int]) -> str:
    """Return the sizes of the splits for people: "11 train, 3 validation, 2 test"."""
    return ", ".join(f"{size:,} {split}" for split, size in zip(SPLITS, sizes, strict=True))


def shift_rows(tables: dict[str, NDArray[Any]], parts: list[dict[str, NDArray[Any]]]) -> None:
    """Turn row numbers within a log into row numbers within the whole."""
    done: Counter[str] = Counter()
    for part in parts:
        episodes, steps, plans = (slice(done[name], done[name] + len(part[name])) for name in ("episodes", "steps", "plans"))
        tables["episodes"]["first_step"][episodes] += done["steps"]
        in_force = tables["steps"]["plan"][steps]
        in_force[in_force >= 0] += done["plans"]
        tables["plans"]["first_position"][plans] += done["positions"]
        for name in ("episodes", "steps", "plans", "positions"):
            done[name] += len(part[name])


def episodes_chosen(episodes: NDArray[Any], wanted: Mapping[str, Sizes]) -> NDArray[np.bool_]:
    """Return which episodes [n] make up the wanted sizes: of each hider and split those of the lowest seeds."""
    kept = np.zeros(len(episodes), np.bool_)
    lacking = {}
    for hider, sizes in wanted.items():
        of_hider = episodes["hider"] == key_of(hider, "hider")
        short = [0, 0, 0]
        for split, size in enumerate(sizes):
            rows = np.flatnonzero(of_hider & (episodes["split"] == split))
            kept[rows[np.argsort(episodes["seed"][rows], kind="stable")][:size]] = True
            short[split] = max(0, size - len(rows))
        if any(short):
            lacking[hider] = (short[0], short[1], short[2])
    if lacking:
        raise TooFewGames(lacking)
    return kept


def rows_kept(tables: dict[str, NDArray[Any]], kept: NDArray[np.bool_], image_kept: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Return the tables without the episodes that are not kept [n]."""
    steps, plans = image_kept[::2], np.repeat(kept, tables["plan_counts"])
    only = {
        "episodes": tables["episodes"][kept],
        "steps": tables["steps"][steps],
        "plans": tables["plans"][plans],
        "positions": tables["positions"][np.repeat(plans, tables["plans"]["positions"])],
        "lengths": tables["lengths"][image_kept],
    }
    in_force = only["steps"]["plan"]
    in_force[:] = np.where(in_force >= 0, (np.cumsum(plans) - 1)[in_force], -1)
    for table, count, row in (("episodes", "steps", "first_step"), ("plans", "positions", "first_position")):
        counts = only[table][count].astype(np.int64)
        only[table][row] = np.cumsum(counts) - counts
    return only


def names_counted(keys: NDArray[np.bytes_], field: str, names: Iterable[set[str]]) -> dict[str, int]:
    """Return whole name -> how many episodes have it."""
    known = {key_of(name, field): name for some in names for name in some}
    return dict(sorted(Counter(known[key] for key in keys.tolist()).items()))
