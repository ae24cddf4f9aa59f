"""Weights on disk: a safetensors file, and beside it the model card, as JSON for machines and Markdown for people."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

import msgspec
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
from vantage.output import complete
from vantage.printable import printable


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


_LARGEST_NUMBER = 4096
"""Of a network's settings: a card that asks for more is not one of ours, and would fill the memory."""


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
        identity: hash of all that decides what the training came to, its seed included (`learning.training_run`); empty where
            an earlier version wrote the card.
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
    identity: str = ""
    version: int = CARD_VERSION


def card_of(network: Network) -> ModelCard:
    """Return a card with what the network itself knows."""
    return ModelCard(network.architecture, asdict(network.settings))


def card_path(path: Path) -> Path:
    """Return where the card of a weights file lies."""
    return path.with_suffix(".json")


def save(network: Network, path: Path, card: ModelCard) -> None:
    """Write weights and card; see `save_state`."""
    card.architecture, card.network = network.architecture, asdict(network.settings)
    save_state(network.state_dict(), path, card)


def save_state(state: Mapping[str, torch.Tensor], path: Path, card: ModelCard) -> None:
    """Write the tensors of a network and the card that describes it.

    All is on disk before the first file gets its name: a full disk leaves the old pair; a crash leaves the old pair, or one that
    `load` refuses, never a wrong one.
    """
    data = save_tensors({name: tensor.detach().cpu().contiguous() for name, tensor in state.items()})
    card.sha256 = hashlib.sha256(data).hexdigest()
    _write(path, card, data)


def amend(path: Path, **training: Any) -> None:
    """Write what a training came to at its end into the card of weights that it saved earlier.

    Raises:
        UnusableWeights: there is no card.
    """
    card = read_card(path)
    card.training.update(training)
    _write(path, card)


def _write(path: Path, card: ModelCard, data: bytes | None = None) -> None:
    with ExitStack() as stack:
        stack.enter_context(complete(path.with_suffix(".md"))).write_bytes(card_text(path.name, card).encode())
        stack.enter_context(complete(card_path(path))).write_bytes((json.dumps(asdict(card), indent=2) + "\n").encode())
        if data is not None:
            stack.enter_context(complete(path)).write_bytes(data)


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
        return msgspec.convert(json.loads(card.read_bytes()), ModelCard)
    except FileNotFoundError:
        raise UnusableWeights(f"the model card {card} is missing: weights are used only with their card") from None
    except RecursionError:
        reason = "its values are nested too deep"
    except (OSError, ValueError, msgspec.MsgspecError) as error:
        reason = _first_line(error)
    raise UnusableWeights(f"the model card {card} cannot be read ({reason}): train again, or fetch weights and card again")


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
        raise UnusableWeights(f"{path} holds a {printable(card.architecture, 40)} network, wanted is {wanted}")
    if hashlib.sha256(data).hexdigest() != card.sha256:
        raise UnusableWeights(f"{path} is not the file that its model card {card_path(path)} describes (sha256 differs)")
    make, kind = ARCHITECTURES[card.architecture]
    try:
        settings, tensors = _settings(card.network, kind), load_tensors(data)
        _check_shapes(make, settings, tensors)
        network = make(settings)
        network.load_state_dict(tensors)
    except _NOT_FITTING as error:
        raise UnusableWeights(f"the weights {path} do not fit the network of their card ({_first_line(error)})") from None
    for name, tensor in network.state_dict().items():
        if not torch.isfinite(tensor).all():
            raise UnusableWeights(
                f"the weights {path} hold numbers that are not finite, in `{name}`: train again, or fetch weights and card again"
            )
    return network.eval(), card


_NOT_FITTING = (
    *(SafetensorError, msgspec.MsgspecError, RecursionError),
    *(RuntimeError, TypeError, ValueError, LookupError, ArithmeticError, AssertionError),  # of torch, for settings of no network
)


def _settings(found: dict[str, Any], kind: type) -> Any:
    """Return the settings of a network as its card has them."""
    if unknown := found.keys() - {item.name for item in fields(kind)}:
        raise ValueError(f"no such network has {', '.join(sorted(unknown))}")
    if any(not 0 <= number <= _LARGEST_NUMBER for number in _numbers(found.values())):
        raise ValueError(f"a number of its settings is not in 0..{_LARGEST_NUMBER}")
    return msgspec.convert(found, kind)


def _numbers(values: Any) -> Iterator[float]:
    for value in values:
        if isinstance(value, list):
            yield from _numbers(value)
        elif isinstance(value, int | float):
            yield value


def _check_shapes(make: Callable[[Any], Any], settings: Any, tensors: Mapping[str, torch.Tensor]) -> None:
    """Compare the network with the file before any memory is taken for it."""
    with torch.device("meta"):
        expected = make(settings).state_dict()
    for name, tensor in expected.items():
        if name not in tensors or tensors[name].shape != tensor.shape:
            raise ValueError(f"the file has no `{name}` of the shape {tuple(tensor.shape)}")


def _first_line(error: BaseException) -> str:
    lines = str(error).splitlines()
    return printable(lines[0], 200) if lines else type(error).__name__


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
