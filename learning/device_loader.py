"""A training set in a GPU's memory: samples are rendered there, pixel for pixel as `Dataset.render` renders them.

State images are kept at four bits a pixel, 8 KiB each, a planned position takes 12 bytes: 5.7 GB for 5,500 games of up to 200
steps with both robots' views (343,440 steps: most games end early). A batch costs one small copy to the device, of its row
numbers, and no loop over its samples.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.dataset import Dataset, Samples, Target
from learning.tensors import Tensors, on_device
from schemas import STATE_IMAGE_SIZE
from vantage.networks.action_vector import SLOTS, SPACING
from vantage.perception.action_maps import SCALE_STEPS, draw_horizons, transform_image
from vantage.perception.palette import OWN, PALETTE, PIXEL_SIZE
from vantage.world.arena import ARENA_SIZE

_SIZE = STATE_IMAGE_SIZE
_PIXELS = _SIZE * _SIZE
_BYTES = _PIXELS // 2  # of an image in memory
_CHUNK = 4096  # images that are packed at a time
_OUTSIDE = _SIZE + 8  # column and row of a position that is drawn nowhere


def needed_bytes(dataset: Dataset) -> int:
    """Return how much device memory a training set takes; beside it, rendering takes about 2 MB for each sample of a batch."""
    return 2 * len(dataset.steps) * _BYTES + 12 * len(dataset.positions)


Resident = Literal["auto", "on", "off"]


def fits(dataset: Dataset, device: torch.device) -> bool:
    """Return whether a training set takes less than half of a GPU's free memory; False where there is no GPU."""
    return device.type == "cuda" and 2 * needed_bytes(dataset) < torch.cuda.mem_get_info(device)[0]


class DeviceDataset:
    """A training set in device memory.

    Args:
        dataset: is read once; all its images are unpacked and moved (seconds).
        device: a GPU; a CPU does as well, slowly.
    """

    def __init__(self, dataset: Dataset, device: torch.device) -> None:
        self._dataset, self._device = dataset, device
        self._images = _packed_images(dataset, device)  # uint8 [2 * steps, 8192]: two pixels a byte, the first in the high bits
        pixels = _pixels_of(dataset.positions)
        self._pixels = torch.from_numpy(pixels).to(device)  # int16 [N, 2] column, row
        self._positions = torch.from_numpy(dataset.positions[:, :2].copy()).to(device)  # float32 [N, 2] x, y in m
        frequency, time, disc = _tables()
        self._frequency, self._time = torch.from_numpy(frequency).to(device), torch.from_numpy(time).to(device)  # uint8 [401]
        self._disc = torch.from_numpy(disc).to(device)  # int64 [21, 2] columns, rows from the middle
        self._sources = torch.from_numpy(_symmetry_sources()).to(device)  # int64 [8, 128 * 128]
        self._turns = torch.from_numpy(_turns()).to(device)  # float64 [8, 2, 2]
        self._palette = torch.from_numpy(PALETTE.copy()).to(device)  # uint8 [5, 3]

    @torch.no_grad()
    def render(self, samples: Samples, target: Target = "seeker", vectors: bool = False) -> Tensors:
        """Return what `tensors_of(dataset.render(samples, target, vectors), device)` returns.

        Raises:
            ValueError: a path ends before its horizon.
        """
        data = self._dataset
        episodes = data.episodes[samples.episode]
        now = episodes["first_step"] + samples.start
        end = samples.start + samples.horizon
        end = episodes["first_step"] + np.where(episodes["caught_step"] >= 0, np.minimum(end, episodes["caught_step"]), end)
        plans = data.plans[data.steps["plan"][now]]
        first = plans["first_position"] + samples.start - plans["start"]
        if len(samples) and (samples.horizon.min() < 0 or (first + samples.horizon >= len(data.positions)).any()):
            raise ValueError("a path ends before its horizon")
        longest = int(samples.horizon.max(initial=0))
        rows = np.stack([2 * now, 2 * end + (target == "seeker"), first, samples.horizon, samples.symmetry, samples.caught])
        shown, wanted, first_at, horizons, symmetries, caught = on_device(rows.astype(np.int64), self._device)  # int64 [B] each

        sources = self._sources[symmetries]  # [B, 16384]
        colors = self._palette[self._view(shown, sources)]  # [B, 16384, 3]
        maps = torch.gather(self._action_maps(first_at, horizons, longest), 1, sources[..., None].expand(-1, -1, 4))
        seen = self._view(wanted, sources)
        count = len(samples)
        return Tensors(
            torch.cat([colors, maps], dim=2).view(count, _SIZE, _SIZE, 7),
            self._vectors(first_at, horizons, symmetries) if vectors else self._positions.new_empty(count, 0),
            self._palette[seen].view(count, _SIZE, _SIZE, 3),
            (seen >= OWN).view(count, _SIZE, _SIZE),
            caught.float(),
        )

    def _view(self, images: Tensor, sources: Tensor) -> Tensor:
        """Return palette indices, int64 [B, 16384]: images [B] of the training set, turned and flipped by `sources`."""
        packed = self._images[images]  # [B, 8192]
        pixels = torch.stack([packed >> 4, packed & 15], dim=2).view(len(images), _PIXELS)
        return torch.gather(pixels, 1, sources).long()

    def _action_maps(self, first: Tensor, horizons: Tensor, longest: int) -> Tensor:
        """Return F and T upright, uint8 [B, 16384, 4], of the positions from rows `first` [B] on, `horizons` [B] steps far."""
        count = len(first)
        step = torch.arange(longest + 1, device=self._device)
        drawn = step <= horizons[:, None]  # [B, S]
        middle = self._pixels[first[:, None] + torch.where(drawn, step, 0)].long()  # [B, S, 2]
        column, row = (middle[:, :, None] + self._disc).unbind(-1)  # [B, S, 21]
        inside = drawn[..., None] & (column >= 0) & (column < _SIZE) & (row >= 0) & (row < _SIZE)
        pixel = torch.where(inside, row * _SIZE + column, _PIXELS).flatten(1)  # what is not drawn goes to one pixel beyond
        visits = torch.zeros(count, _PIXELS + 1, dtype=torch.int32, device=self._device)
        visits.scatter_add_(1, pixel, torch.ones((), dtype=torch.int32, device=self._device).expand(pixel.shape))
        latest = torch.zeros(count, _PIXELS + 1, dtype=torch.int32, device=self._device)
        steps = step.int()[None, :, None].expand(count, -1, len(self._disc)).flatten(1)
        latest.scatter_reduce_(1, pixel, steps, "amax")
        visits, latest = visits[:, :_PIXELS], latest[:, :_PIXELS]
        visited = visits > 0
        frequency = self._frequency[visits.clamp(max=SCALE_STEPS).long()]
        time = self._time[latest.clamp(max=SCALE_STEPS).long()]
        alpha = visited.to(torch.uint8) * 255
        return torch.stack([frequency * visited, alpha, time * visited, alpha], dim=2)

    def _vectors(self, first: Tensor, horizons: Tensor, symmetries: Tensor) -> Tensor:
        """Return the plans as vectors, float32 [B, 121], as `render_vectors`."""
        slot = torch.arange(SLOTS, device=self._device)
        at = torch.minimum(SPACING * (slot + 1), horizons[:, None])  # [B, 40]
        present = slot < torch.clamp((horizons[:, None] + SPACING - 1) // SPACING, min=1)
        where = self._positions[first[:, None] + at].double()  # [B, 40, 2]
        turned = (2.0 * where / ARENA_SIZE - 1.0).clamp(-1.0, 1.0) @ self._turns[symmetries]
        slots = torch.cat([turned, torch.ones_like(turned[..., :1])], dim=2) * present[..., None]  # [B, 40, 3]
        return torch.cat([slots.flatten(1), horizons[:, None] / SCALE_STEPS], dim=1).float()


def _packed_images(dataset: Dataset, device: torch.device) -> Tensor:
    """Return every state image, uint8 [2 * steps, 8192]: image 2 s is the hider's of step s, 2 s + 1 the seeker's."""
    count = 2 * len(dataset.steps)
    images = torch.empty(count, _BYTES, dtype=torch.uint8, device=device)
    for start in range(0, count, _CHUNK):
        stop = min(start + _CHUNK, count)
        raw = b"".join(dataset.image(number // 2, number % 2) for number in range(start, stop))
        pixels = np.frombuffer(raw, np.uint8).reshape(stop - start, _BYTES, 2)
        images[start:stop] = torch.from_numpy(pixels[..., 0] << 4 | pixels[..., 1])
    return images


def _pixels_of(positions: NDArray[np.float32]) -> NDArray[np.int16]:
    """Return column and row [N, 2] of positions in m: at the edge where one lies outside, nowhere where it is not finite."""
    x, y = positions[:, 0].astype(np.float64), positions[:, 1].astype(np.float64)
    known = np.isfinite(x) & np.isfinite(y)
    place = np.stack([np.where(known, x, 0.0), ARENA_SIZE - np.where(known, y, 0.0)], axis=1)
    pixels = np.clip(np.floor(place / PIXEL_SIZE), 0, _SIZE - 1)
    return np.where(known[:, None], pixels, _OUTSIDE).astype(np.int16)


def _tables() -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int64]]:
    """Return the shades of F by visits [401] and of T by steps [401], and the disc of a position [21, 2].

    They are read off the kernel's drawing of a robot that waits in the middle.
    """
    waiting = np.full((SCALE_STEPS + 1, 2), 0.5 * ARENA_SIZE + 0.5 * PIXEL_SIZE)
    maps = np.empty((SCALE_STEPS + 1, 4, _SIZE, _SIZE), np.uint8)
    draw_horizons(waiting, 0, np.arange(SCALE_STEPS + 1), maps)
    rows, columns = np.nonzero(maps[0, 1])
    row, column = int(rows.mean()), int(columns.mean())
    disc = np.stack([columns - column, rows - row], axis=1).astype(np.int64)
    frequency = np.concatenate([[0], maps[:SCALE_STEPS, 0, row, column]]).astype(np.uint8)  # horizon n is n + 1 visits
    return frequency, maps[:, 2, row, column].copy(), disc


def _symmetry_sources() -> NDArray[np.int64]:
    """Return [8, 128 * 128]: which pixel comes to a pixel, read off `transform_image`."""
    rows, columns = (index.astype(np.uint8) for index in np.indices((_SIZE, _SIZE)))
    sources, moved = np.empty((8, _SIZE, _SIZE), np.int64), np.empty((2, _SIZE, _SIZE), np.uint8)
    for symmetry in range(8):
        transform_image(rows, symmetry, moved[0])
        transform_image(columns, symmetry, moved[1])
        sources[symmetry] = moved[0].astype(np.int64) * _SIZE + moved[1]
    return sources.reshape(8, _PIXELS)


def _turns() -> NDArray[np.float64]:
    """Return [8, 2, 2]: a point (x, y) about the middle, as a row, times this is where a symmetry brings it."""
    quarter, mirror = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.diag([-1.0, 1.0])
    return np.stack([(mirror if k >= 4 else np.eye(2)) @ np.linalg.matrix_power(quarter, k % 4) for k in range(8)])
