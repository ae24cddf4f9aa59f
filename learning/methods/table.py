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
from learning.methods.trainings import files_of, trainings_of
from learning.methods.views import PredictedViews
from vantage.networks.inference import folded
from vantage.networks.vpn import Vpn
from vantage.networks.weights import ModelCard, UnusableWeights, load, load_any

Loader = Callable[[str, tuple[Path, ...], Machine], Method]


@dataclass(frozen=True)
class Row:
    """One method.

    Attributes:
        description: one line for people.
        files: stems of the weights it needs, in the order in which they are trained.
        load: name, files, machine -> the method.
        training: the command that makes each file, but for `--to`; {folder} stands for that of the weights.
        paper: accuracy in the paper's Table I (simulation, 1,000 unseen examples), a share; None = not in the paper.
    """

    description: str
    files: tuple[str, ...]
    load: Loader
    training: tuple[str, ...]
    paper: float | None = None


def _views(architecture: str, show: Show) -> Loader:
    def loader(name: str, files: tuple[Path, ...], machine: Machine) -> Method:
        predictor_file, vpn_file = files
        cards: dict[str, ModelCard] = {}
        predictor, cards[predictor_file.stem] = load_any(predictor_file, (architecture,))
        vpn, cards[vpn_file.stem] = load(vpn_file, Vpn)
        return PredictedViews(name, predictor, vpn, show, cards, machine)

    return loader


def _network(files: tuple[Path, ...], architecture: str) -> tuple[Any, dict[str, ModelCard]]:
    (file,) = files
    network, card = load_any(file, (architecture,))
    return network, {file.stem: card}


def _coordinate_value(name: str, files: tuple[Path, ...], machine: Machine) -> Method:
    network, cards = _network(files, "coordinate-value")
    return CaughtAtHorizon(name, machine.prepared(folded(network)), view_and_vector, cards, machine)


def _hazard(name: str, files: tuple[Path, ...], machine: Machine) -> Method:
    network, cards = _network(files, "hazard")
    return Hazard(name, network, cards, machine)


def _hazard_attention(name: str, files: tuple[Path, ...], machine: Machine) -> Method:
    network, cards = _network(files, "hazard-attention")
    return Hazard(name, network, cards, machine, view_and_vector)


def _caught_head(name: str, files: tuple[Path, ...], machine: Machine) -> Method:
    network, cards = _network(files, "vpt-tob")
    (card,) = cards.values()
    if network.head is None or not card.training.get("head_weight"):
        raise UnusableWeights(f"{files[0]} was trained without a caught head")
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
        if not files_of(file, folder):
            path = folder / f"{file}.safetensors"
            return f"{name} left out: no {path}; `vantage {command.format(folder=folder)} --to {path}` makes it"
    return None


def load_trainings(
    names: Iterable[str], folder: Path, machine: Machine | None = None, most: int | None = None
) -> tuple[dict[str, list[Method]], list[str]]:
    """Return the methods whose weights are in a folder, each once for every seed it was trained with, and a line on each that is
    left out.

    Args:
        most: seeds of each; None = all.

    Raises:
        UnusableWeights: weights that are there cannot be used.
    """
    machine = machine or Machine.fastest()
    methods: dict[str, list[Method]] = {}
    left_out: list[str] = []
    for name in names:
        if line := missing(name, folder):
            left_out.append(line)
            continue
        row = METHODS[name]
        found, without = trainings_of(row.files, folder)
        left_out += [line for line in without if line not in left_out]
        try:
            loaded = [row.load(name, training.files, machine) for training in found[:most]]
        except UnusableWeights as error:
            if name != "caught-head":
                raise
            left_out.append(f"{name} left out: {error}; `vantage {row.training[0]}` makes one")  # it is there for VPT-TOB's sake
            continue
        if loaded:
            methods[name] = loaded
        else:
            left_out.append(f"{name} left out: no {row.files[1]} in {folder} belongs to a {row.files[0]} there")
    return methods, left_out


def load_methods(names: Iterable[str], folder: Path, machine: Machine | None = None) -> tuple[list[Method], list[str]]:
    """Return the methods whose weights are in a folder, of one seed each, as `load_trainings`."""
    methods, left_out = load_trainings(names, folder, machine, most=1)
    return [method for (method,) in methods.values()], left_out
