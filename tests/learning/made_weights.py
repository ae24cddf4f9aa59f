"""A small training set of real games, and untrained weights of every method."""

from pathlib import Path

import torch
from torch import nn

from learning.collect import CollectSettings, play_block
from learning.convert import convert
from learning.dataset import Dataset
from vantage.networks.coordinate_value import CoordinateValue, CoordinateValueSettings
from vantage.networks.hazard import Hazard, HazardSettings
from vantage.networks.hazard_attention import HazardAttention, HazardAttentionSettings
from vantage.networks.vector_action import VectorAction, VectorActionSettings
from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.vpt_tob import SelfPerspective, VptTob, VptTobSettings
from vantage.networks.weights import card_of, save

NARROW = (4, 4, 4, 4, 4, 4, 8, 8)


def play_dataset(folder: Path, games: int = 30, steps: int = 40) -> Dataset:
    settings = CollectSettings(hider="goal-walk", seed=52, steps=steps)  # seeds of all three splits
    play_block(settings, range(1, games + 1), folder / "log.mcap")
    convert([folder / "log.mcap"], folder / "dataset", workers=1, quiet=True)
    return Dataset(folder / "dataset")


def untrained() -> dict[str, nn.Module]:
    """Networks by file stem; running means and variances, too, are not those of a new network."""
    torch.manual_seed(3)
    networks: dict[str, nn.Module] = {
        "vpt-tob": VptTob(VptTobSettings(width=0.25, caught_head=True)),
        "whole-image": VptTob(VptTobSettings(width=0.25, whole_image=True)),
        "self-perspective": SelfPerspective(VptTobSettings(width=0.25)),
        "vector-action": VectorAction(VectorActionSettings(width=0.25, hidden=8, embedding=8)),
        "coordinate-path": CoordinateValue(CoordinateValueSettings(variant="path", encoder=NARROW, hidden=8)),
        "coordinate-end": CoordinateValue(CoordinateValueSettings(variant="end", encoder=NARROW, hidden=8)),
        "hazard": Hazard(HazardSettings(encoder=NARROW, hidden=8)),
        "hazard-attention": HazardAttention(HazardAttentionSettings(encoder=NARROW, size=16, heads=2, layers=1)),
        **{stem: Vpn(VpnSettings(width=4, hidden=8)) for stem in ("vpn", "vpn-on-true")},
        **{f"{stem}-vpn": Vpn(VpnSettings(width=4, hidden=8)) for stem in ("whole-image", "self-perspective", "vector-action")},
    }
    for network in networks.values():
        for module in network.modules():
            if isinstance(module, nn.BatchNorm2d):
                nn.init.uniform_(module.running_mean, -0.2, 0.2)  # type: ignore[arg-type]
                nn.init.uniform_(module.running_var, 0.5, 1.5)  # type: ignore[arg-type]
            elif isinstance(module, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
                nn.init.kaiming_normal_(module.weight)  # or all inputs look the same to them
        network.eval()
    return networks


def save_untrained(folder: Path, data_hash: str) -> dict[str, nn.Module]:
    """Save them with cards that say they were trained on this data; a VPN on what its predictor predicts."""
    networks, hashes = untrained(), dict[str, str]()
    for stem, network in networks.items():
        card = card_of(network)  # type: ignore[arg-type]
        card.data, card.training = {"hash": data_hash}, {"samples": 1000, "head_weight": 0.1}
        if isinstance(network, Vpn):
            card.training = {"images": 50}
            views = {"vpn": "vpt-tob"}.get(stem, stem.removesuffix("-vpn"))
            card.inputs = {f"{views}.safetensors": hashes[views]} if views in hashes else {}
        save(network, folder / f"{stem}.safetensors", card)  # type: ignore[arg-type]
        hashes[stem] = card.sha256
    return networks
