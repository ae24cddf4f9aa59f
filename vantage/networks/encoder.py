"""VPT-TOB's encoder by itself, for the networks that say "caught" without predicting a view."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from vantage.networks.vpt_tob import Stage, WholeImage

Channels = tuple[int, int, int, int, int, int, int, int]

PAPER: Channels = (32, 32, 32, 32, 64, 64, 128, 128)
"""Channels of the eight convolutions, pairs at 64, 32, 16 and 8 pixels a side (reading of the paper, row 10)."""


class Encoder(nn.Module):
    """A picture [B, inputs, 128, 128] in 0 .. 1 -> features [B, size].

    Args:
        inputs: channels of the picture.
        channels: of the eight convolutions.
        whole_image: deepen the bottleneck by stages at 4 x 4 and 2 x 2, as VPT-TOB's sibling.
        reduced: channels that the bottleneck of 8 x 8 is reduced to before it is flattened.
        size: of the features.
    """

    def __init__(self, inputs: int, channels: Channels, whole_image: bool, reduced: int, size: int) -> None:
        super().__init__()
        c = (inputs, *channels)
        self.stages = nn.Sequential(*(Stage(c[i], c[i + 1], c[i + 2]) for i in (0, 2, 4, 6)))
        self.context = WholeImage(c[8]) if whole_image else nn.Identity()
        self.reduce = nn.Conv2d(c[8], reduced, 1)
        self.features = nn.Linear(reduced * 8 * 8, size)

    def forward(self, x: Tensor) -> Tensor:
        x = torch.relu_(self.reduce(self.context(self.stages(x))))
        return torch.relu_(self.features(x.flatten(1)))
