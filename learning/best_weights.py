"""The best weights of a training: on disk with their card, and once more in the checkpoint, so that no file is lost for good."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
from torch import Tensor

from learning.training_identity import OtherTraining
from vantage.errors import UserError
from vantage.networks.weights import ModelCard, Network, UnusableWeights, amend, card_path, read_card, save, save_state


class BestWeights:
    """See the module.

    Args:
        path: of the safetensors file.
        digest: of the training's identity; weights of another are never written over.

    Attributes:
        card: of the best weights; None before the first.
    """

    def __init__(self, path: Path, digest: str) -> None:
        self.path, self.digest = path, digest
        self.card: ModelCard | None = None
        self._network: dict[str, Tensor] | None = None

    def state(self) -> dict[str, Any]:
        """Return what the checkpoint holds of them."""
        return {"network": self._network, "card": asdict(self.card) if self.card else None}

    def restore(self, state: dict[str, Any]) -> None:
        self._network = state["network"]
        self.card = msgspec.convert(state["card"], ModelCard) if state["card"] else None

    def keep(self, network: Network, card: ModelCard) -> None:
        """Save weights that are better than those before."""
        card.identity = self.digest
        self._network = {name: tensor.detach().cpu().clone() for name, tensor in network.state_dict().items()}
        self.card = card
        save(network, self.path, card)

    def are_whole(self) -> bool:
        """Return whether the files on disk are these weights and their card."""
        try:
            there = read_card(self.path)
        except UnusableWeights:
            return False
        ours = self.card is not None and there.sha256 == self.card.sha256 == _sha256(self.path)
        return ours and self.path.with_suffix(".md").exists()

    def write(self, came_to: dict[str, Any]) -> None:
        """Write what the training came to into the card; weights that are gone or damaged are written again."""
        assert self.card is not None
        self.card.training |= came_to
        if not self.are_whole():
            assert self._network is not None
            save_state(self._network, self.path, self.card)
        amend(self.path, **came_to)  # always, so that the card's page is worded as one that was read

    def mend(self, came_to: dict[str, Any], over: bool) -> str:
        """Write again what differs from the checkpoint on disk; return a line on it, empty where nothing does.

        Args:
            came_to: see `write`.
            over: the training is, so its card must name what it came to.
        """
        if self.card is None:
            return ""
        if not self.are_whole():
            self.write(came_to)
            return f"{self.path} was gone or damaged: written again, from the checkpoint"
        training = read_card(self.path).training
        if over and {name: training.get(name) for name in came_to} != came_to:
            self.write(came_to)
            return f"{card_path(self.path)} was not final: completed, from the checkpoint"
        return ""

    def refuse_to_overwrite(self, known: bool) -> None:
        """Raise where files of these names are not this training's.

        Args:
            known: the training goes on from its checkpoint, or is to begin again.

        Raises:
            OtherTraining: they are of another training.
            UserError: they are this training's, and its checkpoint is gone.
        """
        if not (self.path.exists() or card_path(self.path).exists()):
            return
        try:
            there = read_card(self.path).identity
        except UnusableWeights:  # ours, where the checkpoint knows them
            there = self.digest if self.card is not None and _sha256(self.path) in ("", self.card.sha256) else ""
        if there != self.digest:
            raise OtherTraining(
                f"{self.path} holds weights of another training, or of an earlier version: choose another --to, or --force to "
                "replace them"
            )
        if not known:
            raise UserError(f"{self.path} is there, but not the checkpoint of its training: --no-resume begins again")


def _sha256(path: Path) -> str:
    """Return the hash of a file; empty where there is none."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
