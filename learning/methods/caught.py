"""Without predicting a view: networks that say themselves whether the hider is caught."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from learning.methods.machine import Machine
from learning.methods.method import Questions
from learning.methods.shown import Show, action_images
from learning.methods.survival import caught_logits
from vantage.networks import hazard
from vantage.networks.hazard_attention import HazardAttention
from vantage.networks.inference import folded
from vantage.networks.vpt_tob import ViewPredictor
from vantage.networks.weights import ModelCard


class CaughtAtHorizon:
    """A network that answers one question at a time: caught at this horizon?

    Args:
        logits: what `show` renders -> logits [n].
    """

    def __init__(
        self, name: str, logits: Callable[..., Tensor], show: Show, cards: dict[str, ModelCard], machine: Machine
    ) -> None:
        self.name, self.cards = name, cards
        self._logits, self._show, self._machine = logits, show, machine

    @classmethod
    def of_head(cls, name: str, network: ViewPredictor, cards: dict[str, ModelCard], machine: Machine) -> CaughtAtHorizon:
        """Return the auxiliary caught head of a VPT-TOB as a method of its own: the view is not even decoded."""
        network = machine.prepared(folded(network))

        def logits(shown: Tensor) -> Tensor:
            caught = network.judge(network.encode(shown))
            assert caught is not None, "weights without a caught head"
            return caught

        return cls(name, logits, action_images, cards, machine)

    def judge(self, questions: Questions) -> NDArray[np.float32]:
        """Return logits of "caught" [B]."""

        def compute(rows: NDArray[np.int64]) -> Tensor:
            return self._logits(*self._show(questions, rows, self._machine))

        return self._machine.run(compute, len(questions))


class Hazard:
    """A one-pass hazard network: asked once a plan, it answers for every horizon.

    Args:
        show: renders whole plans as the network is shown them.
    """

    def __init__(
        self,
        name: str,
        network: hazard.Hazard | HazardAttention,
        cards: dict[str, ModelCard],
        machine: Machine,
        show: Show = action_images,
    ) -> None:
        self.name, self.cards, self._show = name, cards, show
        self._network, self._machine = machine.prepared(folded(network)), machine

    def judge(self, questions: Questions) -> NDArray[np.float32]:
        """Return logits of "caught" [B]; see `caught_logits` for horizons between and beyond the checkpoints."""
        plans = np.stack([questions.view_of, questions.first, questions.last], axis=1)
        _, rows, plan_of = np.unique(plans, axis=0, return_index=True, return_inverse=True)
        if not len(questions):
            return np.zeros(0, np.float32)
        conditional = self.conditional(questions.chosen(rows))
        return caught_logits(conditional[plan_of.ravel()], questions.horizons, self._network.settings.spacing)

    def conditional(self, plans: Questions) -> NDArray[np.float32]:
        """Return the logits of the conditional hazards [P, K] of whole plans, drawn up to the last checkpoint at most, as in
        training; their horizons do not matter."""
        shape = self._network.settings
        reach = shape.checkpoints * shape.spacing - 1
        whole = replace(plans, horizons=np.minimum(plans.last - plans.first, reach))

        def compute(rows: NDArray[np.int64]) -> Tensor:
            return self._network(*self._show(whole, rows, self._machine))

        return self._machine.run(compute, len(plans))
