"""The trainings of a method in a folder of weights: one, or several that differ by their seed alone, as their cards say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vantage.networks.weights import ModelCard, read_card

RUNS = Path("runs")
"""Where trainings leave their weights, if not told otherwise."""
RELEASED = Path(__file__).resolve().parents[2] / "weights"
"""The weights of this release."""

_OF_EACH = ("seed", "samples", "images seen", "minutes", "best after", "epochs seen", "device")
"""What may differ between two trainings that differ by their seed; `samples` by a tenth (of trainings told to last minutes)."""


def weights_folder(given: Path | None) -> Path:
    """Return the folder of weights to read: what was given, else runs/ where a training has left some, else the released ones."""
    if given is not None:
        return given
    return RUNS if any(RUNS.glob("*.safetensors")) else RELEASED


def files_of(stem: str, folder: Path) -> list[Path]:
    """Return the weights of a stem: STEM.safetensors first, then STEM-seedN.safetensors by N."""
    plain = folder / f"{stem}.safetensors"
    seeded = [path for path in folder.glob(f"{stem}-seed*.safetensors") if _number(path, stem) is not None]
    return [path for path in (plain, *sorted(seeded, key=lambda path: _number(path, stem) or 0)) if path.exists()]


def _number(path: Path, stem: str) -> int | None:
    text = path.stem.removeprefix(f"{stem}-seed")
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else None


@dataclass(frozen=True)
class Training:
    """One training of a method.

    Attributes:
        files: of each of its networks, in the order of the method's row.
        cards: of these.
    """

    files: tuple[Path, ...]
    cards: tuple[ModelCard, ...]

    @property
    def seed(self) -> str:
        """Its seed for people; those of its networks where they differ; empty where the cards do not know."""
        seeds = dict.fromkeys(str(card.training.get("seed", "")) for card in self.cards)
        return "/".join(seeds)


def trainings_of(stems: Sequence[str], folder: Path) -> tuple[list[Training], list[str]]:
    """Return the trainings of a method, by seed after the one that is named without, and a line on each file left out.

    Args:
        stems: of its networks; a second one judges what the first predicts.
    """
    first = [Training((path,), (read_card(path),)) for path in files_of(stems[0], folder)]
    found = first if len(stems) == 1 else [pair for one in first for pair in _judged(one, stems, folder)]
    kept: list[Training] = []
    left_out = []
    for training in found:
        name = " and ".join(path.stem for path in training.files)
        if kept and (difference := _difference(kept[0], training)):
            left_out.append(f"{name} left out: it differs from {kept[0].files[-1].stem} by more than its seed ({difference})")
        elif training.seed in {other.seed for other in kept}:
            left_out.append(f"{name} left out: seed {training.seed or 'unknown'} is there already")
        else:
            kept.append(training)
    return kept, left_out


def _judged(predictor: Training, stems: Sequence[str], folder: Path) -> list[Training]:
    """Return a predictor with each network that learnt to judge its predictions; with that of its name where none did."""
    judges = [(path, read_card(path)) for path in files_of(stems[1], folder)]
    (path,), (card,) = predictor.files, predictor.cards
    learnt = [(judge, its) for judge, its in judges if card.sha256 in its.inputs.values()]
    suffix = path.stem.removeprefix(stems[0])
    named = [(judge, its) for judge, its in judges if judge.stem == stems[1] + suffix]
    return [Training((path, judge), (card, its)) for judge, its in learnt or named]


def _difference(one: Training, other: Training) -> str:
    """Return the first thing in which two trainings differ that is not their seed; empty where there is none."""
    for a, b in zip(one.cards, other.cards, strict=True):
        for name in ("architecture", "network", "preset"):
            if getattr(a, name) != getattr(b, name):
                return name
        if a.data.get("hash") != b.data.get("hash"):
            return "training set"
        for name in {**a.training, **b.training}:
            if name not in _OF_EACH and a.training.get(name) != b.training.get(name):
                return name
        for name in ("samples", "images seen"):
            if not _about(a.training.get(name), b.training.get(name)):
                return name
    return ""


def _about(a: Any, b: Any) -> bool:
    if isinstance(a, int | float) and isinstance(b, int | float):
        return math.isclose(a, b, rel_tol=0.1)
    return a is None or b is None
