"""Where networks compute, and how many questions at once."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from vantage.cores import available_cores
from vantage.networks.weights import fast_device, fast_precision

AnyModule = TypeVar("AnyModule", bound=nn.Module)


@dataclass(frozen=True)
class Machine:
    """A device, a precision and a number of threads.

    Every part has the same size, the last one filled up: answers do not depend on the number of threads, and on what else is
    asked no more than by rounding.

    Attributes:
        size: questions in one part.
        threads: parts that are prepared (and on a CPU computed, each by one thread by itself) at the same time.
    """

    device: torch.device
    precision: torch.dtype
    size: int
    threads: int

    @classmethod
    def fastest(cls, threads: int = 0) -> Machine:
        """Return a CUDA GPU where there is one, else the CPU; bfloat16 where it computes with it; `threads` 0 = all cores."""
        device = fast_device()
        cores = threads or available_cores()
        return cls(device, fast_precision(device), 16 if device.type == "cpu" else 256, cores)

    def prepared(self, network: AnyModule, precision: torch.dtype | None = None) -> AnyModule:
        """Return the network, moved here for answering."""
        network = network.eval().to(self.device, precision or self.precision)
        return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def pixels(self, images: NDArray[np.uint8]) -> Tensor:
        """uint8 [B, 128, 128, C] -> [B, C, 128, 128] in 0 .. 1, channels last in memory."""
        return torch.from_numpy(images).to(self.device).permute(0, 3, 1, 2).to(self.precision).mul_(1 / 255)

    def run(self, compute: Callable[[NDArray[np.int64]], Tensor], count: int) -> NDArray[np.float32]:
        """Return `compute(rows)` for rows 0 .. count - 1, part by part.

        Args:
            compute: rows [size] -> [size, ...]; called from several threads at once, without gradients.
        """
        rows = np.minimum(np.arange(-(-count // self.size) * self.size), max(count - 1, 0)).reshape(-1, self.size)

        def part(number: int) -> NDArray[np.float32]:
            with torch.inference_mode():
                return compute(rows[number]).float().cpu().numpy()

        # One thread a part: threads that wait for each other in every layer lose far more than parts that wait once.
        with ThreadPoolExecutor(self.threads, "methods", torch.set_num_threads, (1,)) as pool:
            parts = list(pool.map(part, range(len(rows))))
        return np.concatenate(parts)[:count] if parts else np.zeros(0, np.float32)
