"""VPN: a (predicted) seeker view -> is the hider caught in it? (paper, Value Prediction Network)."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn


@dataclass(frozen=True)
class VpnSettings:
    """Shape of the network: three convolutions, each with a max pool, and two fully connected layers.

    The paper gives the layers, not their sizes: the first convolution has stride 2, so that a value map stays cheap.

    Attributes:
        width: channels of the first convolution; the next two have twice and four times as many.
        hidden: units of the first fully connected layer.
        dropout: probability, after the first fully connected layer.
    """

    width: int = 16
    hidden: int = 64
    dropout: float = 0.5


class Vpn(nn.Module):
    """The network. `forward` gives the logit of "caught", [B], for views [B, 3, 128, 128] in 0 .. 1."""

    architecture = "vpn"

    def __init__(self, settings: VpnSettings | None = None) -> None:
        super().__init__()
        self.settings = settings or VpnSettings()
        w = self.settings.width
        self.layers = nn.Sequential(
            nn.Conv2d(3, w, 5, 2, 2),  # 64 x 64
            nn.ReLU(),
            nn.MaxPool2d(2),
            nn.Conv2d(w, 2 * w, 3, 1, 1),  # 32 x 32
            nn.ReLU(),
            nn.MaxPool2d(2),
            nn.Conv2d(2 * w, 4 * w, 3, 1, 1),  # 16 x 16
            nn.ReLU(),
            nn.MaxPool2d(2),
            nn.Flatten(),  # 4 w x 8 x 8
            nn.Linear(4 * w * 64, self.settings.hidden),
            nn.ReLU(),
            nn.Dropout(self.settings.dropout),
            nn.Linear(self.settings.hidden, 1),
        )

    def forward(self, view: Tensor) -> Tensor:
        return self.layers(view).squeeze(1)
