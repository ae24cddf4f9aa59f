"""VPT-TOB: the hider's view now and its planned path -> the seeker's view at a future step (paper, VPT-TOB Network).

Shapes: B images of 128 x 128. The seven input channels are those of `vantage.networks.inputs`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from vantage.networks.inputs import CHANNELS


@dataclass(frozen=True)
class VptTobSettings:
    """Shape of the network. The defaults are the preset `paper` (reading of the paper, row 10).

    Attributes:
        encoder: channels of the eight convolutions; pairs at 64, 32, 16 and 8 pixels a side.
        decoder: channels of the first three transposed convolutions, at 16, 32 and 64 pixels a side.
        width: multiplies every one of these (rounded to a multiple of four).
        whole_image: deepen the bottleneck by stages at 4 x 4 and 2 x 2, so that every output pixel sees the whole input.
        caught_head: add an auxiliary output to the bottleneck (is the hider caught?), used in training only; not in the paper.
    """

    encoder: tuple[int, int, int, int, int, int, int, int] = (32, 32, 32, 32, 64, 64, 128, 128)
    decoder: tuple[int, int, int] = (64, 32, 16)
    width: float = 1.0
    whole_image: bool = False
    caught_head: bool = False


def _scaled(channels: int, width: float) -> int:
    return channels if width == 1.0 else max(4, round(channels * width / 4) * 4)


class Stage(nn.Module):
    """Convolution k4 s2 p1, then k3 s1 p1, each with BatchNorm and ReLU: halves the image."""

    def __init__(self, inputs: int, middle: int, outputs: int) -> None:
        super().__init__()
        self.down = nn.Conv2d(inputs, middle, 4, 2, 1, bias=False)
        self.down_norm = nn.BatchNorm2d(middle)
        self.same = nn.Conv2d(middle, outputs, 3, 1, 1, bias=False)
        self.same_norm = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        x = torch.relu_(self.down_norm(self.down(x)))
        return torch.relu_(self.same_norm(self.same(x)))


class Up(nn.Module):
    """Transposed convolution k4 s2 p1 with BatchNorm and ReLU: doubles the image."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.up = nn.ConvTranspose2d(inputs, outputs, 4, 2, 1, bias=False)
        self.norm = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu_(self.norm(self.up(x)))


class CoarseView(nn.Module):
    """FlowNet's side branch: a 3-channel picture at this scale, doubled, through a sigmoid."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.predict = nn.Conv2d(inputs, 3, 3, 1, 1)
        self.up = nn.ConvTranspose2d(3, 3, 4, 2, 1)

    def forward(self, x: Tensor) -> Tensor:
        return torch.sigmoid(self.up(self.predict(x)))


class WholeImage(nn.Module):
    """Context for the bottleneck: down to 4 x 4 and 2 x 2 and back, added to what came in."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.to_four = Stage(channels, channels, channels)
        self.to_two = Stage(channels, channels, channels)
        self.from_two = Up(channels, channels)
        self.from_four = Up(channels, channels)

    def forward(self, x: Tensor) -> Tensor:  # [B, C, 8, 8] -> [B, C, 8, 8]
        four = self.to_four(x)
        return x + self.from_four(four + self.from_two(self.to_two(four)))


class ViewPredictor(nn.Module):
    """What all networks that predict a view share: encoder, bottleneck of 8 x 8, decoder, auxiliary head.

    Args:
        settings: shape of the network.
        channels: of the input picture.
        embedded: channels that a subclass joins to the bottleneck before it is decoded.
    """

    architecture = ""

    def __init__(self, settings: VptTobSettings, channels: int, embedded: int = 0) -> None:
        super().__init__()
        self.settings = settings
        c = [_scaled(wide, settings.width) for wide in settings.encoder]
        self.encoder = nn.ModuleList(
            [Stage(channels, c[0], c[1]), Stage(c[1], c[2], c[3]), Stage(c[3], c[4], c[5]), Stage(c[5], c[6], c[7])]
        )
        self.context = WholeImage(c[7]) if settings.whole_image else nn.Identity()
        up, bottom = [_scaled(wide, settings.width) for wide in settings.decoder], c[7] + embedded
        self.ups = nn.ModuleList([Up(bottom, up[0]), Up(up[0] + 3, up[1]), Up(up[1] + 3, up[2])])
        self.coarse = nn.ModuleList([CoarseView(bottom), CoarseView(up[0] + 3), CoarseView(up[1] + 3)])
        self.view = nn.ConvTranspose2d(up[2] + 3, 3, 4, 2, 1)
        self.head = (
            nn.Sequential(
                *(nn.Conv2d(bottom, 16, 1), nn.ReLU(), nn.Flatten(), nn.Linear(16 * 8 * 8, 64), nn.ReLU(), nn.Linear(64, 1))
            )
            if settings.caught_head
            else None
        )

    def encode(self, *shown: Tensor) -> Tensor:
        """The input picture [B, channels, 128, 128] in 0 .. 1 -> bottleneck [B, C, 8, 8]."""
        x = shown[0]
        for stage in self.encoder:
            x = stage(x)
        return self.context(x)

    def decode(self, x: Tensor) -> Tensor:
        """Bottleneck [B, C, 8, 8] -> view [B, 3, 128, 128] before the sigmoid."""
        for up, coarse in zip(self.ups, self.coarse, strict=True):
            x = torch.cat([up(x), coarse(x)], dim=1)
        return self.view(x)

    def forward(self, *shown: Tensor) -> Tensor:
        """What the network is shown -> the predicted view, [B, 3, 128, 128] in 0 .. 1."""
        return torch.sigmoid(self.decode(self.encode(*shown)))

    def forward_with_head(self, *shown: Tensor) -> tuple[Tensor, Tensor | None]:
        """The view, and the auxiliary caught logit [B] (None without the head)."""
        bottleneck = self.encode(*shown)
        return torch.sigmoid(self.decode(bottleneck)), self.judge(bottleneck)

    def judge(self, bottleneck: Tensor) -> Tensor | None:
        """Bottleneck [B, C, 8, 8] -> the auxiliary caught logit [B] (None without the head)."""
        return None if self.head is None else self.head(bottleneck).squeeze(1)


class VptTob(ViewPredictor):
    """The network. `forward(inputs [B, 7, 128, 128])` gives the predicted seeker view, [B, 3, 128, 128], all in 0 .. 1."""

    architecture = "vpt-tob"

    def __init__(self, settings: VptTobSettings | None = None) -> None:
        super().__init__(settings or VptTobSettings(), CHANNELS)


class SelfPerspective(VptTob):
    """Baseline: the same network, which predicts the hider's own view. Another architecture: neither is taken for the other."""

    architecture = "self-perspective"
