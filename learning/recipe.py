"""Recipes of VPT-TOB: the paper's, and what we release. Every difference between the two is one of these settings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from vantage.networks.vpt_tob import VptTobSettings

Schedule = Literal["steps", "cosine"]


@dataclass(frozen=True)
class Recipe:
    """How to train. The defaults are the paper's.

    Attributes:
        samples: how many the network sees (the paper does not say).
        schedule: `steps` multiplies the learning rate by `drop` at 25 % and 65 % of the progress; `cosine` ends at zero.
        disc_weight: weight of a pixel that shows a robot, in the squared error. Discs are 2 % of the picture: unweighted, they
            fade to ghosts at long horizons.
        head_weight: of the loss of the caught head on the bottleneck, 0 = no head.
        judge_weight: of the loss of a small VPN that reads the predicted view while it is being learnt, 0 = none. Neither head
            nor judge is used after training.
        from_start: share of samples with t0 = 0.
        symmetries: of the square, by which samples are turned and flipped: 8, 4 or 1.
    """

    network: VptTobSettings = field(default_factory=VptTobSettings)
    samples: int = 5_000_000
    batch: int = 256
    rate: float = 1e-3
    schedule: Schedule = "steps"
    drop: float = 0.9
    disc_weight: float = 1.0
    head_weight: float = 0.0
    judge_weight: float = 0.0
    from_start: float = 0.5
    symmetries: int = 1


PRESETS: dict[str, Recipe] = {
    "paper": Recipe(),
    "compact": Recipe(
        network=VptTobSettings(encoder=(16, 16, 32, 32, 48, 48, 64, 64), decoder=(32, 16, 8), whole_image=True, caught_head=True),
        samples=800_000,
        batch=32,
        schedule="cosine",
        disc_weight=8.0,
        head_weight=0.03,
        judge_weight=0.03,
        symmetries=8,
    ),
}


def rate_factor(recipe: Recipe, progress: float) -> float:
    """Return the factor of the learning rate at this progress, 0..1."""
    if recipe.schedule == "cosine":
        return max(0.5 * (1.0 + math.cos(math.pi * min(progress, 1.0))), 1e-3)
    return recipe.drop ** sum(progress >= moment for moment in (0.25, 0.65))


def notes_of(preset: str, recipe: Recipe) -> list[str]:
    """Return what people should know of weights trained so."""
    if preset == "paper":
        notes = ["The paper's network and recipe."]
    else:
        notes = ["Not the paper's network: narrower, and its bottleneck sees the whole image (the deeper sibling of row 10)."]
    changed = [
        text
        for differs, text in (
            (recipe.disc_weight != 1.0, f"pixels of the robots' discs weigh {recipe.disc_weight:g} in the squared error"),
            (recipe.head_weight > 0, "an auxiliary caught head on the bottleneck, for training only"),
            (recipe.judge_weight > 0, "a small VPN read the predicted views during training, and its loss was learnt from, too"),
            (recipe.symmetries > 1, f"{recipe.symmetries} symmetries of the square as augmentation"),
            (recipe.batch != 256, f"batch {recipe.batch}"),
            (recipe.schedule != "steps", f"learning rate by {recipe.schedule}"),
        )
        if differs
    ]
    return [*notes, *([f"Beyond the paper's recipe: {'; '.join(changed)}."] if changed else [])]
