"""What learns: any network with its optimiser; and one that predicts a view, with a judge and the losses."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any, Generic, Literal, TypeVar

import numpy as np
import torch
from torch import Tensor, nn
from torch._dynamo.exc import TorchDynamoException
from torch.nn import functional

from learning.dataset import Batch, Target
from learning.group import Group
from learning.measures import area_under_roc
from learning.recipe import Pace, Recipe
from learning.tensors import Tensors, shown_to, tensors_of
from vantage.networks.vector_action import VectorAction, VectorActionSettings
from vantage.networks.vpt_tob import SelfPerspective, ViewPredictor, VptTob, VptTobSettings
from vantage.networks.weights import fast_precision

LearntFrom = TypeVar("LearntFrom")

Model = Literal["vpt-tob", "self-perspective", "vector-action"]
VIEW_ARCHITECTURES: tuple[Model, ...] = ("vpt-tob", "self-perspective", "vector-action")


def make_network(model: Model, shape: VptTobSettings) -> ViewPredictor:
    """Return an untrained network."""
    if model == "vector-action":
        return VectorAction(VectorActionSettings(**asdict(shape)))
    return SelfPerspective(shape) if model == "self-perspective" else VptTob(shape)


def target_of(model: Model) -> Target:
    """Return whose view a model predicts."""
    return "hider" if model == "self-perspective" else "seeker"


class GradientTrainer(ABC, Generic[LearntFrom]):
    """A network that learns by gradient descent, together with those of the other processes: all that a checkpoint holds.

    Subclasses make network, parameters and optimiser.

    Args:
        recipe: how fast it learns.
        group: gradients are averaged over it.
        compiled: compile `forward` for learning.
    """

    network: nn.Module
    parameters: list[nn.Parameter]
    optimizer: torch.optim.Optimizer

    def __init__(self, recipe: Pace, group: Group, compiled: bool) -> None:
        self.recipe, self.group, self.device = recipe, group, group.device
        self.precision = fast_precision(group.device)
        self.forward_in_training = torch.compile(self.forward) if compiled else self.forward

    @abstractmethod
    def forward(self, *inputs: Any) -> Any:
        """Run the network on tensors of the device."""

    @abstractmethod
    def loss_of(self, batch: LearntFrom, forward: Callable[..., Any]) -> Tensor:
        """Return the loss of a batch; `forward` is this class's own, or compiled."""

    def learn(self, batch: LearntFrom, factor: float) -> Tensor:
        """One step of the optimiser, at the recipe's learning rate times a factor; returns the loss."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.recipe.rate * factor
        try:
            loss = self.loss_of(batch, self.forward_in_training)
            loss.backward()
        except TorchDynamoException as error:
            print(f"going on without compiling, it failed: {str(error).strip().splitlines()[0]}", flush=True)
            self.forward_in_training = self.forward
            self.optimizer.zero_grad(set_to_none=True)
            loss = self.loss_of(batch, self.forward)
            loss.backward()
        self.group.average(self.parameters)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        return loss.detach()

    def state(self) -> dict[str, Any]:
        return {"network": self.network.state_dict(), "optimizer": self.optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])


class Judge(nn.Module):
    """Reads a predicted view while it is being learnt: is the hider caught in it? A small and quick VPN."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            *(nn.Conv2d(3, 16, 4, 4), nn.ReLU(), nn.Conv2d(16, 32, 3, 2, 1), nn.ReLU()),
            *(nn.Conv2d(32, 32, 3, 2, 1), nn.ReLU(), nn.Flatten(), nn.Linear(32 * 8 * 8, 64), nn.ReLU(), nn.Linear(64, 1)),
        )

    def forward(self, views: Tensor) -> Tensor:  # [B, 3, 128, 128] -> [B]
        return self.layers(views).squeeze(1)


class Trainer(GradientTrainer[Tensors]):
    """A network that predicts a view, its judge and their losses."""

    recipe: Recipe
    network: ViewPredictor

    def __init__(self, model: Model, recipe: Recipe, group: Group, compiled: bool, seed: int) -> None:
        super().__init__(recipe, group, compiled)
        torch.manual_seed(seed)
        self.model = model
        self.network = make_network(model, recipe.network).to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.judge = Judge().to(self.device, memory_format=torch.channels_last) if recipe.judge_weight else None  # type: ignore[call-overload]
        self.parameters = [*self.network.parameters(), *(self.judge.parameters() if self.judge else ())]
        self.optimizer = torch.optim.Adam(self.parameters, recipe.rate, fused=True)

    def forward(self, batch: Tensors) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss, and by name: the predicted views [B, 3, 128, 128], their mse, the logits of head and judge [B]."""
        _, _, targets, discs, caught = batch
        shown = shown_to(self.network, batch.inputs, batch.vectors, self.precision)
        with torch.autocast(self.device.type, self.precision, enabled=self.precision != torch.float32):
            views, head = self.network.forward_with_head(*shown)
            verdict = self.judge(views) if self.judge else None
        error = (views.float() - targets.permute(0, 3, 1, 2).float() * (1 / 255)).square().mean(dim=1)  # [B, 128, 128]
        found = {"views": views, "mse": error.mean()}
        loss = (
            (error * (1.0 + (self.recipe.disc_weight - 1.0) * discs)).mean() if self.recipe.disc_weight != 1.0 else error.mean()
        )
        for name, logit, weight in (("head", head, self.recipe.head_weight), ("judge", verdict, self.recipe.judge_weight)):
            if logit is not None:
                found[name] = logit.float()
                loss = loss + weight * functional.binary_cross_entropy_with_logits(logit.float(), caught)
        return loss, found

    def loss_of(self, batch: Tensors, forward: Callable[..., Any]) -> Tensor:
        return forward(batch)[0]

    def validate(self, batches: Iterator[Batch]) -> tuple[dict[str, float], tuple[Batch, np.ndarray]]:
        """Return the mean loss and what else can be said, and the first batch with its predicted views [B, 128, 128, 3]."""
        modules = [self.network, *([self.judge] if self.judge else [])]
        for module in modules:
            module.eval()
        total, count, first = {"loss": 0.0, "mse": 0.0}, 0, None
        logits: dict[str, list[Tensor]] = {"head": [], "judge": []}
        caught = []
        with torch.inference_mode():
            for batch in batches:
                loss, found = self.forward(tensors_of(batch, self.device))
                total["loss"] += loss.item() * len(batch.caught)
                total["mse"] += found["mse"].item() * len(batch.caught)
                count += len(batch.caught)
                caught.append(batch.caught)
                for name, values in logits.items():
                    if name in found:
                        values.append(found[name].cpu())
                if first is None:
                    first = batch, found["views"].float().mul(255).round().byte().permute(0, 2, 3, 1).cpu().numpy()
        for module in modules:
            module.train()
        measures = {name: value / count for name, value in total.items()}
        truth = np.concatenate(caught)
        for name, values in logits.items():
            if values:
                scores = torch.cat(values).numpy()
                measures[f"{name} accuracy"] = float(((scores > 0) == truth).mean())
                measures[f"{name} AUROC"] = area_under_roc(scores, truth)
        assert first is not None
        return measures, first

    def state(self) -> dict[str, Any]:
        return {**super().state(), "judge": self.judge.state_dict() if self.judge else None}

    def restore(self, state: dict[str, Any]) -> None:
        super().restore(state)
        if self.judge:
            self.judge.load_state_dict(state["judge"])
