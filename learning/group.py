"""Several training processes as one (`torchrun --nproc-per-node 2 -m vantage.cli train vpt-tob ...`), or one by itself."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, distributed


@dataclass(frozen=True)
class Group:
    """The processes that train together; each sees its own samples, gradients are averaged.

    Attributes:
        rank: of this process; 0 validates, saves and prints.
        size: how many there are.
        device: of this process.
    """

    rank: int
    size: int
    device: torch.device

    def average(self, parameters: Sequence[Tensor]) -> None:
        """Average the gradients over the group."""
        if self.size == 1:
            return
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        flat = torch.cat([gradient.reshape(-1) for gradient in gradients])
        distributed.all_reduce(flat)
        flat /= self.size
        at = 0
        for gradient in gradients:
            gradient.copy_(flat[at : at + gradient.numel()].view_as(gradient))
            at += gradient.numel()

    def agree(self, progress: float, stop: bool) -> tuple[float, bool]:
        """Return the progress that process 0 has, and whether any process was asked to stop: the same for all."""
        if self.size == 1:
            return progress, stop
        shared = torch.tensor([progress if self.rank == 0 else 0.0, float(stop)], dtype=torch.float64, device=self.device)
        distributed.all_reduce(shared)
        return float(shared[0]), bool(shared[1] > 0)

    def leave(self) -> None:
        """The last call of a process."""
        if self.size > 1:
            distributed.destroy_process_group()


def join_group() -> Group:
    """Return the group that `torchrun` has started, or this process by itself. One GPU a process, or the CPU."""
    size, rank = int(os.environ.get("WORLD_SIZE", "1")), int(os.environ.get("RANK", "0"))
    cuda = torch.cuda.is_available()
    device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0"))) if cuda else torch.device("cpu")
    if cuda:
        torch.cuda.set_device(device)
        torch.backends.cudnn.benchmark = True  # every batch has the same shape
    if size > 1:
        distributed.init_process_group("nccl" if cuda else "gloo")
    return Group(rank, size, device)
