"""Coordinate-value baseline: the hider's view now and coordinates of its plan -> caught? (paper, Baselines).

The paper names "a vector action embedding with spatial coordinate information, and a future coordinate value where the hider will
end up". Two declared variants: `path` is told the path every ten steps, where it ends, and the horizon; `end` the end alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from vantage.networks.action_vector import SLOTS, VECTOR_LENGTH
from vantage.networks.encoder import PAPER, Channels, Encoder


@dataclass(frozen=True)
class CoordinateValueSettings:
    """Shape of the network. The defaults are the preset `paper`, variant `path`.

    Attributes:
        variant: what of the action vector the network is told.
        encoder: channels of the eight convolutions, as VPT-TOB's.
        whole_image: as VPT-TOB's.
        reduced: channels of the bottleneck before it is flattened.
        hidden: units of every fully connected layer.
        dropout: probability, before the last layer.
    """

    variant: Literal["path", "end"] = "path"
    encoder: Channels = PAPER
    whole_image: bool = True
    reduced: int = 32
    hidden: int = 128
    dropout: float = 0.2


class CoordinateValue(nn.Module):
    """The network. `forward(view [B, 3, 128, 128] in 0 .. 1, vector [B, 121])` gives the logit of "caught", [B]."""

    architecture = "coordinate-value"

    def __init__(self, settings: CoordinateValueSettings | None = None) -> None:
        super().__init__()
        self.settings = s = settings or CoordinateValueSettings()
        self.encoder = Encoder(3, s.encoder, s.whole_image, s.reduced, s.hidden)
        told = VECTOR_LENGTH if s.variant == "path" else 2
        self.embed = nn.Sequential(nn.Linear(told, s.hidden), nn.ReLU(), nn.Linear(s.hidden, s.hidden), nn.ReLU())
        self.caught = nn.Sequential(
            *(nn.Linear(2 * s.hidden, s.hidden), nn.ReLU(), nn.Dropout(s.dropout), nn.Linear(s.hidden, 1))
        )

    def forward(self, view: Tensor, vector: Tensor) -> Tensor:
        told = vector if self.settings.variant == "path" else end_of(vector)
        return self.caught(torch.cat([self.encoder(view), self.embed(told)], dim=1)).squeeze(1)


def end_of(vector: Tensor) -> Tensor:
    """Return where the paths of action vectors end, x and y in -1..1: [B, 121] -> [B, 2]."""
    slots = vector[:, :-1].unflatten(1, (SLOTS, 3))
    last = slots[:, :, 2].sum(dim=1).long() - 1  # [B] the last slot present
    return slots[torch.arange(len(slots), device=slots.device), last, :2]
