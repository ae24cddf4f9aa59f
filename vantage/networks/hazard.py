"""Hazard network: the hider's view now and its whole plan -> the chance of a catch in every interval. One pass for all horizons.

Not in the paper. Time is cut at the checkpoints t = N - 1, 2 N - 1, ..., K N - 1 steps after now: those of the value map (reading
of the paper, row 14). Logit k is that of the conditional hazard: caught after checkpoint k - 1 and not after checkpoint k, given
that the hider survived checkpoint k - 1. Whether it is caught by k is the product of the survived intervals, so it only grows.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from vantage.networks.encoder import PAPER, Channels, Encoder
from vantage.networks.inputs import CHANNELS


@dataclass(frozen=True)
class HazardSettings:
    """Shape of the network. The defaults are the preset `paper`.

    Attributes:
        encoder: channels of the eight convolutions, as VPT-TOB's.
        whole_image: as VPT-TOB's.
        reduced: channels of the bottleneck before it is flattened.
        hidden: units of the fully connected layer.
        dropout: probability, after the fully connected layer.
        checkpoints: K.
        spacing: N, steps between two checkpoints.
    """

    encoder: Channels = PAPER
    whole_image: bool = True
    reduced: int = 32
    hidden: int = 128
    dropout: float = 0.2
    checkpoints: int = 20
    spacing: int = 10


class Hazard(nn.Module):
    """The network. `forward(inputs [B, 7, 128, 128] in 0 .. 1)`, F and T of the whole plan, gives hazard logits [B, K]."""

    architecture = "hazard"

    def __init__(self, settings: HazardSettings | None = None) -> None:
        super().__init__()
        self.settings = s = settings or HazardSettings()
        self.encoder = Encoder(CHANNELS, s.encoder, s.whole_image, s.reduced, s.hidden)
        self.hazards = nn.Sequential(nn.Dropout(s.dropout), nn.Linear(s.hidden, s.checkpoints))

    def forward(self, x: Tensor) -> Tensor:
        return self.hazards(self.encoder(x))


def caught_probability(logits: Tensor) -> Tensor:
    """Return the probability of being caught by each checkpoint, which never falls: [B, K] -> [B, K]."""
    return -torch.expm1(-_cumulative(logits))


def survival_loss(logits: Tensor, caught: Tensor, known: Tensor) -> Tensor:
    """Return the discrete-time survival loss: the mean over samples of minus the log-likelihood of what is known.

    Args:
        logits: hazard logits. [B, K]
        caught: whether caught by each checkpoint. bool [B, K]
        known: whether the outcome is known there, and the plan reaches it. bool [B, K]
    """
    at_risk = ~functional.pad(caught[:, :-1], (1, 0))  # survived the checkpoint before
    terms = functional.binary_cross_entropy_with_logits(logits, caught.to(logits.dtype), reduction="none")
    return (terms * (at_risk & known)).sum(dim=1).mean()


def _cumulative(logits: Tensor) -> Tensor:
    """Minus the logarithm of the survival at each checkpoint. [B, K] -> [B, K]"""
    return functional.softplus(logits).cumsum(dim=1)
