"""All methods: which weights each needs, how it is loaded, how its weights are made. A new method is a row here."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.methods.caught import CaughtAtHorizon, Hazard
from learning.methods.machine import Machine
from learning.methods.method import Method
from learning.methods.shown import Show, action_images, view_and_vector
from learning.methods.views import PredictedViews
from vantage.networks.inference import folded
from vantage.networks.vpn import Vpn
from vantage.networks.weights import ModelCard, UnusableWeights, load, load_any

Loader = Callable[[str, Path, Machine], Method]


@dataclass(frozen=True)
class Row:
    """One method.

    Attributes:
        description: one line for people.
        files: stems of the weights it needs, in the order in which they are trained.
        load: name, folder, machine -> the method.
        training: the command that makes each file, but for `--to`; {folder} stands for that of the weights.
        paper: accuracy in the paper's Table I (simulation, 1,000 unseen examples), a share; None = not in the paper.
    """

    description: str
    files: tuple[str, ...]
    load: Loader
    training: tuple[str, ...]
    paper: float | None = None


def _views(architecture: str, show: Show) -> Loader:
    def loader(name: str, folder: Path, machine: Machine) -> Method:
        predictor_file, vpn_file = METHODS[name].files
        cards: dict[str, ModelCard] = {}
        predictor, cards[predictor_file] = load_any(folder / f"{predictor_file}.safetensors", (architecture,))
        vpn, cards[vpn_file] = load(folder / f"{vpn_file}.safetensors", Vpn)
        return PredictedViews(name, predictor, vpn, show, cards, machine)

    return loader


def _network(name: str, folder: Path, architecture: str) -> tuple[Any, dict[str, ModelCard]]:
    (file,) = METHODS[name].files
    network, card = load_any(folder / f"{file}.safetensors", (architecture,))
    return network, {file: card}


def _coordinate_value(name: str, folder: Path, machine: Machine) -> Method:
    network, cards = _network(name, folder, "coordinate-value")
    return CaughtAtHorizon(name, machine.prepared(folded(network)), view_and_vector, cards, machine)


def _hazard(name: str, folder: Path, machine: Machine) -> Method:
    network, cards = _network(name, folder, "hazard")
    return Hazard(name, network, cards, machine)


def _hazard_attention(name: str, folder: Path, machine: Machine) -> Method:
    network, cards = _network(name, folder, "hazard-attention")
    return Hazard(name, network, cards, machine, view_and_vector)


def _caught_head(name: str, folder: Path, machine: Machine) -> Method:
    network, cards = _network(name, folder, "vpt-tob")
    card = cards["vpt-tob"]
    if network.head is None or not card.training.get("head_weight"):
        raise UnusableWeights(f"{folder / 'vpt-tob.safetensors'} was trained without a caught head")
    return CaughtAtHorizon.of_head(name, network, cards, machine)


METHODS: dict[str, Row] = {
    "self-perspective": Row(
        "predicts the hider's own future view; VPN",
        ("self-perspective", "self-perspective-vpn"),
        _views("self-perspective", action_images),
        ("train vpt-tob --model self-perspective", "train vpn --views {folder}/self-perspective.safetensors"),
        0.7661,
    ),
    "coordinate-path": Row(
        "path every 10 steps + horizon as numbers; says caught",
        ("coordinate-path",),
        _coordinate_value,
        ("train caught --model coordinate-path",),
        0.7640,
    ),
    "coordinate-end": Row(
        "end coordinate as numbers; says caught",
        ("coordinate-end",),
        _coordinate_value,
        ("train caught --model coordinate-end",),
        0.7640,
    ),
    "vector-action": Row(
        "predicts the seeker's view from the path as numbers; VPN",
        ("vector-action", "vector-action-vpn"),
        _views("vector-action", view_and_vector),
        ("train vpt-tob --model vector-action", "train vpn --views {folder}/vector-action.safetensors"),
        0.8298,
    ),
    "vpt-tob": Row(
        "predicts the seeker's view from F and T; VPN",
        ("vpt-tob", "vpn"),
        _views("vpt-tob", action_images),
        ("train vpt-tob", "train vpn --views {folder}/vpt-tob.safetensors"),
        0.8845,
    ),
    "whole-image": Row(
        "VPT-TOB whose bottleneck sees the whole image; VPN",
        ("whole-image", "whole-image-vpn"),
        _views("vpt-tob", action_images),
        ("train vpt-tob --preset whole-image", "train vpn --views {folder}/whole-image.safetensors"),
    ),
    "caught-head": Row(
        "auxiliary head on VPT-TOB's bottleneck, no view",
        ("vpt-tob",),
        _caught_head,
        ("train vpt-tob --preset compact",),
    ),
    "hazard": Row(
        "one pass over the whole plan: caught by every checkpoint",
        ("hazard",),
        _hazard,
        ("train caught --model hazard",),
    ),
    "hazard-attention": Row(
        "the same, shown the plan as a sequence of positions",
        ("hazard-attention",),
        _hazard_attention,
        ("train caught --model hazard-attention",),
    ),
    "vpn-on-true": Row(
        "ablation: VPT-TOB with a VPN that learnt from true views",
        ("vpt-tob", "vpn-on-true"),
        _views("vpt-tob", action_images),
        ("train vpt-tob", "train vpn --on true"),
    ),
}

ABLATIONS = ("vpn-on-true",)
"""Not compared unless asked for."""


def missing(name: str, folder: Path) -> str | None:
    """Return one line on the first file that a method lacks in a folder of weights and the command that makes it, or None."""
    row = METHODS[name]
    for file, command in zip(row.files, row.training, strict=True):
        path = folder / f"{file}.safetensors"
        if not path.exists():
            return f"{name} left out: no {path}; `vantage {command.format(folder=folder)} --to {path}` makes it"
    return None


def load_methods(names: Iterable[str], folder: Path, machine: Machine | None = None) -> tuple[list[Method], list[str]]:
    """Return the methods whose weights are in a folder, and a line on each that is left out.

    Raises:
        UnusableWeights: weights that are there cannot be used.
    """
    machine = machine or Machine.fastest()
    methods: list[Method] = []
    left_out: list[str] = []
    for name in names:
        line = missing(name, folder)
        if line is None and name == "caught-head":  # the file is there for VPT-TOB's sake
            try:
                methods.append(METHODS[name].load(name, folder, machine))
            except UnusableWeights as error:
                line = f"{name} left out: {error}; `vantage {METHODS[name].training[0]}` makes one"
        elif line is None:
            methods.append(METHODS[name].load(name, folder, machine))
        if line is not None:
            left_out.append(line)
    return methods, left_out
