"""Weights on disk: a safetensors file, and beside it the model card, as JSON for machines and Markdown for people."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from vantage.errors import UserError
from vantage.networks.coordinate_value import CoordinateValue, CoordinateValueSettings
from vantage.networks.hazard import Hazard, HazardSettings
from vantage.networks.hazard_attention import HazardAttention, HazardAttentionSettings
from vantage.networks.vector_action import VectorAction, VectorActionSettings
from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.vpt_tob import SelfPerspective, VptTob, VptTobSettings


class Network(Protocol):
    """A network that can be saved: its settings, a dataclass, are all that it is made from."""

    architecture: str
    settings: Any

    def state_dict(self) -> dict[str, Any]: ...
    def load_state_dict(self, state_dict: Mapping[str, Any]) -> Any: ...
    def eval(self) -> Self: ...


AnyNetwork = TypeVar("AnyNetwork", bound=Network)

CARD_VERSION = 1
ARCHITECTURES: dict[str, tuple[Callable[[Any], Any], type]] = {  # network, settings
    "vpt-tob": (VptTob, VptTobSettings),
    "self-perspective": (SelfPerspective, VptTobSettings),
    "vector-action": (VectorAction, VectorActionSettings),
    "vpn": (Vpn, VpnSettings),
    "hazard": (Hazard, HazardSettings),
    "hazard-attention": (HazardAttention, HazardAttentionSettings),
    "coordinate-value": (CoordinateValue, CoordinateValueSettings),
}


class UnusableWeights(UserError, ValueError):
    """The weights cannot be used; the text says why and what to do."""


@dataclass
class ModelCard:
    """What weights are, and how they came to be.

    Attributes:
        architecture: a row of ARCHITECTURES.
        network: the network's settings.
        sha256: of the safetensors file.
        preset: of the training; `paper` is the paper's recipe.
        training: every setting of the training, and what it came to (samples seen, minutes, device).
        data: hash, kind and size of the training set.
        metrics: what was measured on validation episodes at the end.
        commit: source tree that trained.
        inputs: hashes of other weights that went in (the VPT-TOB whose predictions a VPN learnt from).
        notes: for people: what differs from the paper.
    """

    architecture: str
    network: dict[str, Any]
    sha256: str = ""
    preset: str = ""
    training: dict[str, Any] = field(default_factory=dict)
    data: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    commit: str = ""
    inputs: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    version: int = CARD_VERSION


def card_of(network: Network) -> ModelCard:
    """Return a card with what the network itself knows."""
    return ModelCard(network.architecture, asdict(network.settings))


def card_path(path: Path) -> Path:
    """Return where the card of a weights file lies."""
    return path.with_suffix(".json")


def save(network: Network, path: Path, card: ModelCard) -> None:
    """Write weights and card; a crash leaves the old pair or a pair that `load` refuses, never a wrong one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    state = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    data = save_tensors(state)
    card.architecture, card.network = network.architecture, asdict(network.settings)
    card.sha256 = hashlib.sha256(data).hexdigest()
    _replace(path, data)
    _replace(card_path(path), (json.dumps(asdict(card), indent=2) + "\n").encode())
    _replace(path.with_suffix(".md"), card_text(path.name, card).encode())


def _replace(path: Path, data: bytes) -> None:
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(data)
    os.replace(partial, path)


def amend(path: Path, **training: Any) -> None:
    """Write what a training came to at its end into the card of weights that it saved earlier.

    Raises:
        UnusableWeights: there is no card.
    """
    card = read_card(path)
    card.training.update(training)
    _replace(card_path(path), (json.dumps(asdict(card), indent=2) + "\n").encode())
    _replace(path.with_suffix(".md"), card_text(path.name, card).encode())


def card_text(name: str, card: ModelCard) -> str:
    """Return the card as Markdown."""
    lines = [f"# {name}", "", f"{card.architecture}, preset `{card.preset}`, sha256 `{card.sha256}`, commit `{card.commit}`", ""]
    lines += [f"* {note}" for note in card.notes] + ([""] if card.notes else [])
    for title, table in (("Metrics", card.metrics), ("Data", card.data), ("Training", card.training), ("Network", card.network)):
        if table:
            lines += [f"## {title}", "", "| what | value |", "|---|---|"]
            lines += [f"| {key} | {_short(value)} |" for key, value in table.items()] + [""]
    lines += [f"Learnt from `{name}` `{digest}`." for name, digest in card.inputs.items()]
    return "\n".join(lines).rstrip() + "\n"


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def read_card(path: Path) -> ModelCard:
    """Return the card of a weights file.

    Raises:
        UnusableWeights: it is missing, or not a card.
    """
    card = card_path(path)
    try:
        content = json.loads(card.read_text())
        known = {item.name for item in fields(ModelCard)}
        return ModelCard(**{key: value for key, value in content.items() if key in known})
    except FileNotFoundError:
        raise UnusableWeights(f"the model card {card} is missing: weights are used only with their card") from None
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise UnusableWeights(
            f"the model card {card} cannot be read ({error}): train again, or fetch weights and card again"
        ) from None


def load(path: Path, kind: type[AnyNetwork]) -> tuple[AnyNetwork, ModelCard]:
    """Return the network of a safetensors file, in evaluation mode on the CPU, and its card.

    Raises:
        UnusableWeights: file or card is missing or broken, they do not belong together, or hold another network than `kind`.
    """
    return load_any(path, (kind.architecture,))


def load_any(path: Path, architectures: Collection[str] = ARCHITECTURES) -> tuple[Any, ModelCard]:
    """Return the network of a safetensors file, whichever of the architectures its card names, as `load`.

    Raises:
        UnusableWeights: as `load`.
    """
    wanted = " or ".join(architectures)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise UnusableWeights(f"no weights at {path}, wanted is {wanted}: train some (`vantage --help` says how)") from None
    except OSError as error:
        raise UnusableWeights(f"the weights {path} cannot be read: {error}") from None
    card = read_card(path)
    if card.architecture not in architectures:
        raise UnusableWeights(f"{path} holds a {card.architecture} network, wanted is {wanted}")
    if hashlib.sha256(data).hexdigest() != card.sha256:
        raise UnusableWeights(f"{path} is not the file that its model card {card_path(path)} describes (sha256 differs)")
    make, settings = ARCHITECTURES[card.architecture]
    try:
        network = make(settings(**_tuples(card.network)))
        network.load_state_dict(load_tensors(data))
    except (SafetensorError, RuntimeError, TypeError, ValueError, KeyError) as error:
        reason = str(error).splitlines()[0]
        raise UnusableWeights(f"the weights {path} do not fit the network of their card ({reason})") from None
    return network.eval(), card


def _tuples(settings: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in settings.items()}


def fast_device() -> torch.device:
    """Return the device to compute on: a CUDA GPU where there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def fast_precision(device: torch.device) -> torch.dtype:
    """Return bfloat16 where the device computes with it, else float32."""
    if device.type == "cuda":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float32
    return torch.bfloat16 if torch.ops.mkldnn._is_mkldnn_bf16_supported() and _has_bf16_instructions() else torch.float32


def _has_bf16_instructions() -> bool:
    try:
        return "avx512_bf16" in Path("/proc/cpuinfo").read_text() or "amx_bf16" in Path("/proc/cpuinfo").read_text()
    except OSError:
        return False
