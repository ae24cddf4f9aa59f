"""Attention hazard network: the hider's view now and its whole plan as a sequence -> the chance of a catch in every interval.

Not in the paper. It answers what `vantage.networks.hazard` answers, but is shown the plan as the positions it passes (the action
vector of the whole plan) instead of as pictures: one token a checkpoint, which knows where the hider is to be by then, what the
view shows there, and how far that is from where the view shows the seeker. A token looks back at earlier ones only, for what the
hider does later cannot get it caught now, and anywhere in the view.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from vantage.networks.action_vector import SLOTS
from vantage.networks.encoder import PAPER, Channels
from vantage.networks.vpt_tob import Stage, WholeImage
from vantage.perception.palette import OTHER, PALETTE

_TOLD = 12
"""Numbers a token is told of its place."""


@dataclass(frozen=True)
class HazardAttentionSettings:
    """Shape of the network. The defaults are the preset `paper`.

    Attributes:
        encoder: channels of the eight convolutions, as VPT-TOB's.
        size: of a token.
        heads: of attention.
        layers: of the decoder, each: among earlier tokens, to the view, two fully connected layers.
        dropout: probability, in every layer.
        checkpoints: K, at most the slots of an action vector.
        spacing: N, steps between two checkpoints: that of an action vector.
    """

    encoder: Channels = PAPER
    size: int = 96
    heads: int = 4
    layers: int = 3
    dropout: float = 0.1
    checkpoints: int = 20
    spacing: int = 10


class HazardAttention(nn.Module):
    """The network. `forward(view [B, 3, 128, 128] in 0 .. 1, vector [B, 121] of the whole plan)` gives hazard logits [B, K]."""

    architecture = "hazard-attention"
    column: Tensor
    seeker_color: Tensor

    def __init__(self, settings: HazardAttentionSettings | None = None) -> None:
        super().__init__()
        self.settings = s = settings or HazardAttentionSettings()
        c = (3, *s.encoder)
        self.stages = nn.ModuleList(Stage(c[i], c[i + 1], c[i + 2]) for i in (0, 2, 4, 6))
        self.context = WholeImage(c[8])
        self.view = nn.Conv2d(c[8], s.size, 1)
        self.place = nn.Parameter(torch.randn(s.size, 8, 8) * 0.02)
        self.told = nn.Sequential(nn.Linear(_TOLD + c[4] + c[6], s.size), nn.ReLU(), nn.Linear(s.size, s.size))
        self.moment = nn.Parameter(torch.randn(s.checkpoints, s.size) * 0.02)
        layer = nn.TransformerDecoderLayer(
            s.size, s.heads, 2 * s.size, s.dropout, activation=functional.relu, batch_first=True, norm_first=True
        )
        self.decoder = nn.TransformerDecoder(layer, s.layers, nn.LayerNorm(s.size))
        self.hazards = nn.Linear(s.size, 1)
        later = torch.ones(s.checkpoints, s.checkpoints, dtype=torch.bool).triu(1)
        self.register_buffer("later", later, persistent=False)
        column = (torch.arange(128) + 0.5) / 64 - 1  # where pixels lie, -1..1
        self.register_buffer("column", column, persistent=False)
        self.register_buffer("seeker_color", torch.from_numpy(PALETTE[OTHER] / 255.0).float(), persistent=False)

    def forward(self, view: Tensor, vector: Tensor) -> Tensor:
        quarter = self.stages[1](self.stages[0](view))  # [B, C, 32, 32]
        eighth = self.stages[2](quarter)  # [B, C, 16, 16]
        sixteenth = self.context(self.stages[3](eighth))  # [B, C, 8, 8]
        seen = (self.view(sixteenth) + self.place).flatten(2).transpose(1, 2)  # [B, 64, size]
        slots = vector[:, :-1].unflatten(1, (SLOTS, 3))[:, : self.settings.checkpoints]  # [B, K, 3]
        places = slots[:, :, :2]
        there = [_sampled(image, places) for image in (quarter, eighth)]
        told = torch.cat([self._told(view, slots), *there], dim=2)
        tokens = self.told(told.to(view.dtype)) + self.moment
        return self.hazards(self.decoder(tokens, seen, tgt_mask=self.later)).squeeze(2)

    def _told(self, view: Tensor, slots: Tensor) -> Tensor:
        """What a token is told of its place: position, presence, the way since the token before and its length, the way from
        where the seeker is seen and its length, that place itself, and whether it is seen. [B, K, 12]"""
        places, present = slots[:, :, :2], slots[:, :, 2:]
        step = torch.diff(places, dim=1, prepend=places[:, :1])
        seeker, visible = self._seeker(view)
        away = (places - seeker[:, None]) * visible[:, None]
        parts = [places, present, step, step.norm(dim=2, keepdim=True), away, away.norm(dim=2, keepdim=True)]
        return torch.cat([*parts, (seeker * visible)[:, None].expand_as(places), visible[:, None].expand_as(present)], dim=2)

    def _seeker(self, view: Tensor) -> tuple[Tensor, Tensor]:
        """Where the view shows the seeker: the centre of its disc [B, 2], x and y in -1..1, and whether at all [B, 1]."""
        mask = ((view.float() - self.seeker_color[:, None, None]).abs().amax(dim=1) < 0.1).float()
        count = mask.sum(dim=(1, 2))
        x = (mask.sum(dim=1) * self.column).sum(dim=1)
        y = -(mask.sum(dim=2) * self.column).sum(dim=1)  # row 0 is the far side
        centre = torch.stack([x, y], dim=1) / count.clamp(min=1.0)[:, None]
        return centre.to(view.dtype), (count > 0).to(view.dtype)[:, None]


def _sampled(image: Tensor, places: Tensor) -> Tensor:
    """Features of an image [B, C, H, H] at places [B, K, 2], x and y in -1..1 over the arena -> [B, K, C]."""
    grid = (places * places.new_tensor([1.0, -1.0]))[:, :, None].to(image.dtype)  # [B, K, 1, 2]
    return functional.grid_sample(image, grid, padding_mode="border", align_corners=False).squeeze(3).transpose(1, 2)
