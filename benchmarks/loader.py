"""Does the loader starve training? Samples rendered by one thread, beside samples learnt from, on one core, in one run.

    python -m benchmarks.loader --data data/dataset

Both are counted per second of processor time, so that what else the machine does hardly matters: training with n threads needs n
times its one-core speed from the one thread that renders. Where there is a GPU, the loader that renders there is timed, too.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro

from learning.dataset import DEFAULT_DATASET, Dataset, Samples
from learning.device_loader import DeviceDataset, needed_bytes
from learning.group import Group
from learning.recipe import PRESETS
from learning.tensors import tensors_of
from learning.trainer import Trainer
from vantage.networks.inputs import CHANNELS, render_inputs, render_targets

LIMIT = 4.0  # times the speed of training on one core


@dataclass(frozen=True)
class Settings:
    """Time the loader beside training."""

    data: Path = DEFAULT_DATASET
    """A training set."""
    presets: tuple[str, ...] = ("compact", "paper")
    """Recipes to train by."""
    batches: int = 40
    """Batches of 32 to render; a quarter as many are learnt from."""


def rate(work: Callable[[Samples], object], batches: list[Samples]) -> float:
    """Return samples per second of processor time; the first batch does not count."""
    work(batches[0])
    started = time.process_time()
    for samples in batches[1:]:
        work(samples)
    return sum(map(len, batches[1:])) / (time.process_time() - started)


def parts_of(data: Dataset, batches: list[Samples]) -> dict[str, float]:
    """Return seconds a sample for each part of rendering."""
    views = np.zeros((len(batches[0]), 128, 128), np.uint8)
    inputs = np.empty((len(batches[0]), 128, 128, CHANNELS), np.uint8)
    targets, discs = np.empty((len(batches[0]), 128, 128, 3), np.uint8), np.empty((len(batches[0]), 128, 128), np.bool_)
    rows = np.arange(len(batches[0]))

    def unpack(samples: Samples) -> None:
        for step in data.episodes["first_step"][samples.episode] + samples.start:
            data.image(int(step), 0), data.image(int(step), 1)

    def draw(samples: Samples, horizon: np.ndarray) -> None:
        now = data.episodes["first_step"][samples.episode] + samples.start
        plans = data.plans[data.steps["plan"][now]]
        first = plans["first_position"] + samples.start - plans["start"]
        render_inputs(views, rows, data.positions, first, horizon, samples.symmetry, inputs)

    unpacked = 1 / rate(unpack, batches)
    drawn = 1 / rate(lambda samples: draw(samples, samples.horizon), batches)
    colored = 1 / rate(lambda samples: draw(samples, np.zeros_like(samples.horizon)), batches)
    targeted = 1 / rate(lambda samples: render_targets(views, samples.symmetry, targets, discs), batches)
    return {
        "lz4, two images": unpacked,
        "F and T": max(drawn - colored, 0.0),
        "colours and symmetry of the input": colored,
        "colours and symmetry of the target": targeted,
    }


def learning_rate(trainer: Trainer, data: Dataset, batches: list[Samples]) -> float:
    """Return samples learnt from per second of processor time, rendered beforehand."""
    ready = {id(samples): tensors_of(data.render(samples), trainer.device) for samples in batches}
    return rate(lambda samples: trainer.learn(ready[id(samples)], 1.0), batches)


def main(settings: Settings) -> int:
    torch.set_num_threads(1)
    data, generator = Dataset(settings.data), np.random.default_rng(0)
    batches = [data.draw("train", 32, generator) for _ in range(settings.batches)]
    rendered = rate(data.render, batches)
    print(f"{settings.data}: {sum(data.manifest['episodes'].values()):,} games; samples per second of one core")
    print(f"  drawing samples            {rate(lambda samples: data.draw('train', len(samples), generator), batches):10,.0f}")
    print(f"  rendering them             {rendered:10,.0f}")
    parts = parts_of(data, batches)
    parts["fresh memory for the arrays, and the rest"] = max(1 / rendered - sum(parts.values()), 0.0)
    for name, seconds in sorted(parts.items(), key=lambda part: -part[1]):
        print(f"    {name:<42}{1e6 * seconds:7.1f} us a sample")
    print(f"  what limits rendering: {max(parts, key=lambda name: parts[name])}")
    ok, cpu = True, Group(0, 1, torch.device("cpu"))
    for preset in settings.presets:
        trainer = Trainer("vpt-tob", PRESETS[preset], cpu, compiled=False, seed=0)
        learnt = learning_rate(trainer, data, batches[: 1 + settings.batches // 4])
        ok &= rendered >= LIMIT * learnt
        print(f"  learning, preset {preset:<10}{learnt:10,.0f}   rendering is {rendered / learnt:5.1f} times as fast")
    print(f"rendering must be {LIMIT:g} times as fast as one core learns: {'met' if ok else 'MISSED'}")
    if torch.cuda.is_available():
        on_gpu(data, settings.batches)
    return 0 if ok else 1


def on_gpu(data: Dataset, count: int) -> None:
    """Print how fast the GPU renders."""
    device = torch.device("cuda")
    started = time.perf_counter()
    loader = DeviceDataset(data, device)
    print(f"GPU: {needed_bytes(data) / 1e9:.1f} GB, loaded in {time.perf_counter() - started:.1f} s")
    batches = [data.draw("train", 256, np.random.default_rng(number)) for number in range(count)]
    loader.render(batches[0])
    torch.cuda.synchronize()
    started = time.perf_counter()
    for samples in batches:
        loader.render(samples)
    torch.cuda.synchronize()
    print(f"  rendering there            {256 * count / (time.perf_counter() - started):10,.0f} samples/s, batch 256")


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
