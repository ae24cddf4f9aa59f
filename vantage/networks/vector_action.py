"""Vector-action baseline: VPT-TOB whose action maps are replaced by a vector of coordinates (paper, Baselines).

The encoder sees the hider's view alone. The vector goes through two fully connected layers and is joined to the bottleneck, the
same at each of its 8 x 8 places: "this embedding is concatenated with the intermediate features to produce the final image".
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from vantage.networks.vpt_tob import ViewPredictor, VptTobSettings


@dataclass(frozen=True)
class VectorActionSettings(VptTobSettings):
    """Shape of the network: encoder and decoder as VPT-TOB's.

    Attributes:
        vector: numbers in an action vector (`vantage.networks.action_vector.VECTOR_LENGTH`).
        hidden: units of the first fully connected layer.
        embedding: units of the second one: channels that are joined to the bottleneck.
    """

    vector: int = 40 * 3 + 1
    hidden: int = 256
    embedding: int = 128


class VectorAction(ViewPredictor):
    """The network. `forward(view [B, 3, 128, 128], vector [B, V])` gives the predicted seeker view, [B, 3, 128, 128]."""

    architecture = "vector-action"

    def __init__(self, settings: VectorActionSettings | None = None) -> None:
        settings = settings or VectorActionSettings()
        super().__init__(settings, 3, settings.embedding)
        self.embed = nn.Sequential(
            *(nn.Linear(settings.vector, settings.hidden), nn.ReLU()),
            *(nn.Linear(settings.hidden, settings.embedding), nn.ReLU()),
        )

    def encode(self, *shown: Tensor) -> Tensor:
        """View [B, 3, 128, 128] in 0 .. 1 and action vector [B, V] -> bottleneck [B, C + embedding, 8, 8]."""
        view, vector = shown
        features = super().encode(view)
        embedded = self.embed(vector)[:, :, None, None].expand(-1, -1, *features.shape[2:])
        return torch.cat([features, embedded], dim=1)
