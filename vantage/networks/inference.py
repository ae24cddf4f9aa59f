"""VPT-TOB and VPN together, made for answering: BatchNorm folded into the convolutions, one batch size, buffers kept."""

from __future__ import annotations

import copy
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from schemas import STATE_IMAGE_SIZE
from vantage.cores import available_cores
from vantage.networks.inputs import CHANNELS
from vantage.networks.vpn import Vpn
from vantage.networks.vpt_tob import Stage, Up, VptTob
from vantage.networks.weights import fast_device, fast_precision, load

AnyModule = TypeVar("AnyModule", bound=nn.Module)


def folded(network: AnyModule) -> AnyModule:
    """Return a copy that computes the same in evaluation mode without BatchNorm layers."""
    network = copy.deepcopy(network).eval()
    for module in network.modules():
        if isinstance(module, Stage):
            module.down, module.down_norm = fuse_conv_bn_eval(module.down, module.down_norm), nn.Identity()  # type: ignore[assignment]
            module.same, module.same_norm = fuse_conv_bn_eval(module.same, module.same_norm), nn.Identity()  # type: ignore[assignment]
        elif isinstance(module, Up):
            module.up, module.norm = fuse_conv_bn_eval(module.up, module.norm, transpose=True), nn.Identity()  # type: ignore[assignment]
    return network


PART = 16
"""Images that one CPU thread computes at once."""


class Inference:
    """Answers batches of a fixed size, so that an answer does not depend on what else was asked with it.

    On a CPU the batch is cut into parts, each computed by one thread by itself: where cores are shared, threads that wait for
    each other in every layer lose far more than parts that wait once.

    Attributes:
        hash: of the weights, for the reply: `vpt-tob:... vpn:...`, 16 digits each.
        inputs: uint8 [batch, 128, 128, 7], to be filled by the caller.
    """

    def __init__(self, vpt_tob: VptTob, vpn: Vpn, batch: int = 64, threads: int = 0) -> None:
        self.device = fast_device()
        self.precision = fast_precision(self.device)
        self._vpt_tob = self._prepared(folded(vpt_tob))
        self._vpn = self._prepared(copy.deepcopy(vpn).eval())
        self.hash = ""
        self.batch = batch
        self.threads = threads or available_cores()
        self.inputs: NDArray[np.uint8] = np.zeros((batch, STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, CHANNELS), np.uint8)
        self._shared = torch.from_numpy(self.inputs).permute(0, 3, 1, 2)  # the same memory, [batch, 7, 128, 128]
        self._pixels = torch.empty_like(self._shared, dtype=self.precision, device=self.device)
        self._caught = torch.empty(batch, device=self.device)
        self._views = torch.empty(batch, 3, STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, dtype=self.precision, device=self.device)
        size = batch if self.device.type != "cpu" else PART
        self._parts = [slice(first, min(first + size, batch)) for first in range(0, batch, size)]
        self._pool = ThreadPoolExecutor(self.threads, "networks")
        if self.device.type == "cpu":
            torch.set_num_threads(1)

    def _prepared(self, network: nn.Module) -> nn.Module:
        return network.to(self.device, self.precision).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @classmethod
    def of_weights(cls, folder: Path, batch: int = 64, threads: int = 0) -> Inference:
        """Load `vpt-tob.safetensors` and `vpn.safetensors` of a folder.

        Raises:
            UnusableWeights: see `vantage.networks.weights.load`.
        """
        vpt_tob, vpt_tob_card = load(folder / "vpt-tob.safetensors", VptTob)
        vpn, vpn_card = load(folder / "vpn.safetensors", Vpn)
        inference = cls(vpt_tob, vpn, batch, threads)
        inference.hash = f"vpt-tob:{vpt_tob_card.sha256[:16]} vpn:{vpn_card.sha256[:16]}"
        return inference

    @torch.inference_mode()
    def _compute(self, part: slice) -> None:
        pixels = self._pixels[part]
        pixels.copy_(self._shared[part])
        pixels.mul_(1 / 255)
        views = self._vpt_tob(pixels)  # [part, 3, 128, 128]
        self._views[part] = views
        self._caught[part] = torch.sigmoid(self._vpn(views).float())

    def answer(self, views: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Return the probability of "caught" [batch] for all of `inputs`, and the predicted views uint8 [n, 128, 128, 3] of
        the rows `views` [n].
        """
        list(self._pool.map(self._compute, self._parts))
        wanted = self._views[torch.from_numpy(views).to(self.device)].float().mul_(255).round_().byte().permute(0, 2, 3, 1)
        return self._caught.cpu().numpy().copy(), wanted.contiguous().cpu().numpy()
