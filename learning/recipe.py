"""Recipes of the networks that predict a view, and of the VPN: the paper's, and what we release. Differences are settings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from vantage.networks.encoder import PAPER, Channels
from vantage.networks.vpn import VpnSettings
from vantage.networks.vpt_tob import VptTobSettings

Schedule = Literal["steps", "cosine"]


@dataclass(frozen=True)
class Pace:
    """How fast to learn.

    Attributes:
        batch: samples a step.
        rate: learning rate of Adam at the beginning.
        schedule: `steps` multiplies the rate by `drop` at each of the `moments`; `cosine` ends at zero.
        moments: in 0..1 of the progress.
    """

    batch: int = 256
    rate: float = 1e-3
    schedule: Schedule = "steps"
    drop: float = 0.9
    moments: tuple[float, float] = (0.25, 0.65)


def rate_factor(pace: Pace, progress: float) -> float:
    """Return the factor of the learning rate at this progress, 0..1."""
    if pace.schedule == "cosine":
        return max(0.5 * (1.0 + math.cos(math.pi * min(progress, 1.0))), 1e-3)
    return pace.drop ** sum(progress >= moment for moment in pace.moments)


@dataclass(frozen=True)
class Recipe(Pace):
    """How to train a network that predicts a view. The defaults are the paper's.

    Attributes:
        network: shape of the network; the vector-action baseline takes what it shares with VPT-TOB.
        samples: how many the network sees (the paper does not say).
        disc_weight: weight of a pixel that shows a robot, in the squared error. Discs are 2 % of the picture: unweighted, they
            fade to ghosts at long horizons.
        head_weight: of the loss of the caught head on the bottleneck, 0 = no head.
        judge_weight: of the loss of a small VPN that reads the predicted view while it is being learnt, 0 = none. It is not used
            after training.
        from_start: share of samples with t0 = 0.
        symmetries: of the square, by which samples are turned and flipped: 8, 4 or 1.
    """

    network: VptTobSettings = field(default_factory=VptTobSettings)
    samples: int = 5_000_000
    disc_weight: float = 1.0
    head_weight: float = 0.0
    judge_weight: float = 0.0
    from_start: float = 0.5
    symmetries: int = 1


PRESETS: dict[str, Recipe] = {
    "paper": Recipe(),
    "whole-image": Recipe(network=VptTobSettings(whole_image=True)),
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


@dataclass(frozen=True)
class VpnRecipe(Pace):
    """How to train a VPN. The defaults are the paper's.

    Attributes:
        images: predicted views to learn from.
        epochs: how often each is seen.
        stream: predict as the training goes, every image for a sample and a symmetry of its own; else all of them before it.
        pool: of the latest predictions, from which the batches of a stream are drawn.
        held: views of validation games to choose the best weights by.
        symmetries: 4 = quarter turns (the paper), 8 = flips, too.
        from_start: share of samples with t0 = 0.
        on: `predictions` of a network, or `true` views of the seeker (an ablation).
    """

    rate: float = 5e-4
    moments: tuple[float, float] = (0.20, 0.50)
    network: VpnSettings = field(default_factory=VpnSettings)
    images: int = 2000
    epochs: int = 100
    stream: bool = False
    pool: int = 4096
    held: int = 400
    symmetries: int = 4
    from_start: float = 0.5
    on: Literal["predictions", "true"] = "predictions"


VPN_PRESETS: dict[str, VpnRecipe] = {
    "paper": VpnRecipe(),
    "compact": VpnRecipe(images=200_000, epochs=2, stream=True, held=4000, batch=64, rate=1e-3, schedule="cosine", symmetries=8),
}


def notes_of(recipe: Recipe) -> list[str]:
    """Return what people should know of weights trained so."""
    paper, narrower = PRESETS["paper"], replace(recipe.network, whole_image=False, caught_head=False) != VptTobSettings()
    deeper = "its bottleneck sees the whole image (the deeper sibling of row 10)" if recipe.network.whole_image else ""
    shape = [text for text in ("narrower" if narrower else "", deeper) if text]
    changed = [
        text
        for differs, text in (
            (recipe.disc_weight != 1.0, f"pixels of the robots' discs weigh {recipe.disc_weight:g} in the squared error"),
            (recipe.head_weight > 0, "an auxiliary caught head on the bottleneck"),
            (recipe.judge_weight > 0, "a small VPN read the predicted views during training, and its loss was learnt from, too"),
            (recipe.symmetries > 1, f"{recipe.symmetries} symmetries of the square as augmentation"),
            (recipe.batch != paper.batch, f"batch {recipe.batch}"),
            (recipe.schedule != "steps", f"learning rate by {recipe.schedule}"),
            (recipe.schedule == "steps" and recipe.drop != paper.drop, f"learning rate times {recipe.drop:g} at 25 % and 65 %"),
        )
        if differs
    ]
    return [
        f"Not the paper's network: {', and '.join(shape)}." if shape else "The paper's network.",
        f"Beyond the paper's recipe: {'; '.join(changed)}." if changed else "The paper's recipe.",
    ]


def vpn_notes_of(recipe: VpnRecipe) -> list[str]:
    """Return what people should know of a VPN trained so."""
    changed = [
        text
        for differs, text in (
            (
                recipe.network != VpnSettings(),
                f"first convolution {recipe.network.width} wide, {recipe.network.hidden} hidden units",
            ),
            (recipe.on == "true", "learnt from true views"),
            (recipe.stream, "a stream of fresh images"),
            ((recipe.images, recipe.epochs) != (2000, 100), f"{recipe.images:,} images, each seen {recipe.epochs} times"),
            (recipe.schedule != "steps", f"learning rate by {recipe.schedule}"),
            (recipe.schedule == "steps" and recipe.drop != 0.9, f"learning rate times {recipe.drop:g} at 20 % and 50 %"),
            (recipe.symmetries != 4, "flips beside quarter turns"),
        )
        if differs
    ]
    return [f"Not the paper's recipe: {'; '.join(changed)}." if changed else "The paper's recipe."]


CaughtModel = Literal["hazard", "hazard-attention", "coordinate-path", "coordinate-end"]


@dataclass(frozen=True)
class CaughtRecipe(Pace):
    """How to train. The defaults are those of VPT-TOB's preset `paper`, with its encoder: equal data, no symmetries added.

    Attributes:
        encoder: channels of the encoder's convolutions.
        whole_image: a bottleneck that sees the whole image.
        dropout: before the last layer.
        samples: how many the network sees.
        weight_decay: of AdamW.
        from_start: share of samples with t0 = 0.
        symmetries: of the square, by which samples are turned and flipped: 8, 4 or 1.
    """

    encoder: Channels = PAPER
    whole_image: bool = True
    dropout: float = 0.2
    samples: int = 5_000_000
    weight_decay: float = 0.0
    from_start: float = 0.5
    symmetries: int = 1


CAUGHT_PRESETS: dict[str, CaughtRecipe] = {
    "paper": CaughtRecipe(),
    "compact": CaughtRecipe(
        symmetries=8, encoder=(16, 16, 32, 32, 48, 48, 64, 64), samples=800_000, batch=32, schedule="cosine", weight_decay=0.01
    ),
}


def caught_recipe(model: CaughtModel, preset: Literal["paper", "compact"]) -> CaughtRecipe:
    """Return a preset's recipe for a network; attention learns at half the rate of convolutions."""
    recipe = CAUGHT_PRESETS[preset]
    return replace(recipe, rate=0.5 * recipe.rate) if model == "hazard-attention" else recipe


def caught_notes_of(model: CaughtModel, recipe: CaughtRecipe) -> list[str]:
    """Return what people should know of weights trained so."""
    beyond = model in ("hazard", "hazard-attention")
    kind = "Beyond the paper: one pass for all horizons." if beyond else "The paper's baseline coordinate-value."
    narrower = "; narrower than the paper's encoder" if recipe.encoder != PAPER else ""
    return [kind, f"Recipe: {recipe.symmetries} symmetries, batch {recipe.batch}, learning rate by {recipe.schedule}{narrower}."]
