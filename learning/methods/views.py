"""The paper's way: predict a view, then let a VPN say whether the hider is caught in it."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from learning.dataset import Dataset, Samples
from learning.methods.machine import Machine
from learning.methods.method import Questions
from learning.methods.shown import Show
from vantage.networks.inference import folded
from vantage.networks.vpn import Vpn
from vantage.networks.vpt_tob import ViewPredictor
from vantage.networks.weights import ModelCard


class PredictedViews:
    """A network that predicts a view at the horizon (the seeker's; the hider's own for self-perspective), and its VPN.

    Args:
        show: renders what the predictor is shown.
    """

    def __init__(
        self, name: str, predictor: ViewPredictor, vpn: Vpn, show: Show, cards: dict[str, ModelCard], machine: Machine
    ) -> None:
        self.name, self.cards = name, cards
        self._predictor, self._vpn = machine.prepared(folded(predictor)), machine.prepared(vpn)
        self._show, self._machine = show, machine

    def judge(self, questions: Questions) -> NDArray[np.float32]:
        """Return the VPN's logits of "caught" [B]."""

        def compute(rows: NDArray[np.int64]) -> Tensor:
            return self._vpn(self._predictor(*self._show(questions, rows, self._machine)))

        return self._machine.run(compute, len(questions))

    def predict(self, questions: Questions) -> NDArray[np.uint8]:
        """Return the predicted views, RGB uint8 [B, 128, 128, 3]."""

        def compute(rows: NDArray[np.int64]) -> Tensor:
            return self._predictor(*self._show(questions, rows, self._machine)).float().mul(255).round().permute(0, 2, 3, 1)

        return self._machine.run(compute, len(questions)).astype(np.uint8)


def judge_true_views(vpn: Vpn, data: Dataset, samples: Samples, machine: Machine) -> NDArray[np.float32]:
    """Return the VPN's logits of "caught" [B] on the views that the seeker really had, as a perfect predictor would show."""
    vpn = machine.prepared(vpn)

    def compute(rows: NDArray[np.int64]) -> Tensor:
        chosen = Samples(*(getattr(samples, field.name)[rows] for field in fields(Samples)))
        return vpn(machine.pixels(data.render(chosen).targets))

    return machine.run(compute, len(samples))
