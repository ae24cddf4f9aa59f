"""How large a reproduction is: one table of presets. Times are for two free CPU cores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Model = Literal[
    "vpt-tob",
    "self-perspective",
    "vector-action",
    "whole-image",
    "coordinate-path",
    "coordinate-end",
    "hazard",
    "hazard-attention",
]
VIEW_MODELS: tuple[Model, ...] = ("vpt-tob", "self-perspective", "vector-action", "whole-image")
"""Predict a view, which a VPN then judges; the others say caught or not themselves."""
COMPARED: tuple[Model, ...] = ("vpt-tob", "self-perspective", "vector-action", "hazard", "coordinate-path", "coordinate-end")
"""Equal data and an equal number of samples: Table I and the network that goes beyond the paper."""

NetworkPreset = Literal["paper", "whole-image", "compact"]


@dataclass(frozen=True)
class Kind:
    """One kind of data.

    Attributes:
        seeker: preset of the seeker.
        layout: of the arena.
        steps: T, the longest game.
        games: to train, validate and test on.
        label: tells two kinds apart that differ in size alone.
    """

    seeker: str
    layout: str
    steps: int
    games: tuple[int, int, int]
    label: str = ""

    @property
    def name(self) -> str:
        return "-".join([self.seeker, self.layout, str(self.steps), *([self.label] if self.label else [])])

    def as_played(self, other: Kind) -> bool:
        """Whether the games are of the same kind, however many: then the same seeds are test games in both."""
        return (self.seeker, self.layout, self.steps) == (other.seeker, other.layout, other.steps)


_PAPER_GAMES = (4500, 500, 500)
_MAIN = Kind("glancing", "random", 200, _PAPER_GAMES)
_LARGE = Kind("glancing", "random", 200, (18_000, 500, 500), "large")


@dataclass(frozen=True)
class Group:
    """Networks trained on the same data with the same number of samples, in one folder of weights.

    Attributes:
        name: of the folder, and of the row on the results page.
        models: which networks.
        networks: preset of networks and recipes.
        samples: each network sees; 0 = nothing is trained, the weights are given.
        vpn: images and epochs of each VPN; None = as its preset has it.
        batch: samples a step; None = as the preset has it.
        drop: factor of the learning rate at each drop; None = as the preset has it.
        kind: of the data it learns from; None = the main one. Judged on the main one, too, where that is played alike.
        plain: without the losses of the caught head and of the judge, which the other compared networks cannot have.
        maps: judge its value maps, too.
        mapped: the models whose maps are judged; None = all.
        vpn_on_true: ablation: also a VPN that learns from true views, judged on predictions.
        seeds: each network is trained once with each; with several, tables show how far these lie apart.
        caveats: by method, what stands beside each of its figures.
    """

    name: str
    models: tuple[Model, ...]
    networks: NetworkPreset
    samples: int
    vpn: tuple[int, int] | None = None
    batch: int | None = None
    drop: float | None = None
    kind: Kind | None = None
    plain: bool = False
    maps: bool = False
    mapped: tuple[Model, ...] | None = None
    vpn_on_true: bool = False
    seeds: tuple[int, ...] = (1,)
    caveats: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Preset:
    """The size of everything.

    Attributes:
        groups: the first one is Table I.
        examples: unseen examples for each horizon: the paper's number and one for a tight interval.
        oracle: simulations from the true state for each of how many examples.
        starts: arenas whose value maps are judged.
        simulations: of every goal of a start, beside that with the episode's own seed.
        main: kind of data that everything compared is trained and judged on.
        others: kinds that the compared networks are judged on without having seen them.
        horizons: T of the examples.
        map_horizons: T of the value maps.
        seed: of the first game; everything else is seeded by its own options' defaults.
    """

    groups: tuple[Group, ...]
    examples: tuple[int, ...]
    oracle: tuple[int, int]
    starts: int
    simulations: int
    main: Kind = _MAIN
    others: tuple[Kind, ...] = ()
    horizons: tuple[int, ...] = (100, 200)
    map_horizons: tuple[int, ...] = (200, 250, 300, 350)
    seed: int = 1


_CHOSEN = "chosen between two trainings on test games, which flatters this figure a little"
RELEASED = Group(
    "released",
    ("vpt-tob", "hazard-attention"),
    "compact",
    0,
    maps=True,
    mapped=("vpt-tob", "hazard-attention"),
    caveats=(("vpt-tob", _CHOSEN), ("caught-head", _CHOSEN)),
)
"""The weights of this release, judged on the same examples and maps."""


def _rates(samples: int, model: Model, batch: int | None = None) -> tuple[Group, ...]:
    """Return the ablation of the learning rate: "decrease the learning rate by 10 %" read as x0.9, x0.5 and x0.1."""
    return tuple(Group(f"drop-{drop:g}", (model,), "paper", samples, batch=batch, drop=drop) for drop in (0.9, 0.5, 0.1))


def _other_kinds(games: tuple[int, int, int]) -> tuple[Kind, ...]:
    return (
        Kind("expert", "random", 200, games),
        Kind("glancing", "lab", 200, games),
        Kind("expert", "lab", 200, games),
        Kind("glancing", "random", 350, games),
    )


PRESETS: dict[str, Preset] = {
    # Some 25 minutes: the paper's number of games, small networks that see few samples.
    "quick": Preset(
        groups=(
            Group("compared", COMPARED, "compact", 26_000, vpn=(16_000, 3), plain=True, maps=True, vpn_on_true=True),
            Group("with-head", ("vpt-tob",), "compact", 26_000, vpn=(16_000, 3)),
            RELEASED,
            *_rates(12_000, "hazard", batch=32),
        ),
        examples=(1_000, 3_000),
        oracle=(20, 200),
        starts=12,
        simulations=4,
    ),
    # Some two hours; the networks trained for longer are the released ones.
    "hours": Preset(
        others=_other_kinds((300, 50, 300))[1:2],
        groups=(
            Group(
                "compared",
                COMPARED,
                "compact",
                80_000,
                vpn=(24_000, 3),
                plain=True,
                maps=True,
                mapped=("vpt-tob", "hazard", "coordinate-path"),
            ),
            RELEASED,
        ),
        examples=(1_000, 10_000),
        oracle=(30, 800),
        starts=50,
        simulations=6,
    ),
    # The paper's scale: a sitting on a GPU, days on two cores.
    "paper": Preset(
        others=_other_kinds(_PAPER_GAMES),
        groups=(
            Group("compared", (*COMPARED, "whole-image"), "paper", 5_000_000, maps=True, vpn_on_true=True),
            Group("longer", ("vpt-tob", "hazard", "hazard-attention"), "compact", 5_000_000, kind=_LARGE, maps=True),
            RELEASED,
            *(Group(kind.name, ("vpt-tob", "hazard"), "paper", 5_000_000, kind=kind) for kind in _other_kinds(_PAPER_GAMES)),
            *_rates(1_000_000, "vpt-tob"),
        ),
        examples=(1_000, 10_000),
        oracle=(50, 1_000),
        starts=50,
        simulations=20,
    ),
    # Seconds: the tests'.
    "smoke": Preset(
        main=Kind("glancing", "random", 40, (40, 10, 10)),
        groups=(
            Group("compared", ("vpt-tob", "self-perspective", "hazard"), "compact", 128, vpn=(64, 1), maps=True),
            Group("drop-0.5", ("hazard",), "compact", 64, drop=0.5, seeds=(1, 2)),
        ),
        examples=(40,),
        horizons=(20, 40),
        oracle=(3, 20),
        starts=2,
        simulations=2,
        map_horizons=(40, 60),
    ),
}
