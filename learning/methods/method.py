"""What is asked of every method, and how a method answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # a training set is opened without torch
    from vantage.networks.weights import ModelCard


@dataclass(frozen=True)
class Questions:
    """B questions: is the hider, who saw views[view_of[b]] and drives the plan whose positions begin (now) at row first[b] and
    end at row last[b], caught horizons[b] steps from now?"""

    views: NDArray[np.uint8]  # [V, 128, 128] palette indices
    view_of: NDArray[np.int64]  # [B] row of `views`
    positions: NDArray[np.float32]  # [N, 3] x, y (m), heading (rad), one plan after the other
    first: NDArray[np.int64]  # [B] row of `positions` at step 0
    last: NDArray[np.int64]  # [B], >= first + horizon
    horizons: NDArray[np.int64]  # [B] steps

    def __len__(self) -> int:
        return len(self.horizons)

    def chosen(self, rows: NDArray[np.int64]) -> Questions:
        """Return the questions `rows`."""
        return Questions(self.views, self.view_of[rows], self.positions, self.first[rows], self.last[rows], self.horizons[rows])


class Method(Protocol):
    """Answers questions.

    Attributes:
        name: as in `METHODS`.
        cards: of the weights it uses, by file stem.
    """

    name: str
    cards: dict[str, ModelCard]

    def judge(self, questions: Questions) -> NDArray[np.float32]:
        """Return logits of "caught" [B]."""
        ...
