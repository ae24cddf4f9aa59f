"""From rendered samples to what a network is shown, on the device that computes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.dataset import Batch
from vantage.networks.vector_action import VectorAction
from vantage.networks.vpt_tob import ViewPredictor


class Tensors(NamedTuple):
    """A batch on the device."""

    inputs: Tensor  # uint8 [B, 128, 128, 7]
    vectors: Tensor  # float32 [B, 121], or [B, 0] where nothing reads them
    targets: Tensor  # uint8 [B, 128, 128, 3]
    discs: Tensor  # bool [B, 128, 128]
    caught: Tensor  # float32 [B]


def on_device(array: NDArray[np.generic], device: torch.device) -> Tensor:
    """Return an array on the device; to a GPU the copy runs beside the computation."""
    tensor = torch.from_numpy(array)
    return tensor.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else tensor


def tensors_of(batch: Batch, device: torch.device) -> Tensors:
    """Return a rendered batch on the device."""
    arrays = (batch.inputs, batch.vectors, batch.targets, batch.discs, batch.caught.astype(np.float32))
    return Tensors(*(on_device(array, device) for array in arrays))


def in_unit_range(pictures: Tensor, precision: torch.dtype) -> Tensor:
    """uint8 [B, 128, 128, C] -> [B, C, 128, 128] in 0 .. 1, channels last in memory."""
    return pictures.permute(0, 3, 1, 2).to(precision) * (1 / 255)


def shown_to(network: ViewPredictor, inputs: Tensor, vectors: Tensor, precision: torch.dtype) -> tuple[Tensor, ...]:
    """Return the arguments of a network that predicts a view, of `Tensors.inputs` and `Tensors.vectors`."""
    if isinstance(network, VectorAction):
        return in_unit_range(inputs[..., :3].contiguous(), precision), vectors
    return (in_unit_range(inputs, precision),)
