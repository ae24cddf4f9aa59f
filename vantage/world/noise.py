"""Random numbers without a state: the value depends on (seed, stream, counters) only, never on the order of the draws.

The mixing is splitmix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from vantage.compiled import kernel

LAYOUT_STREAM: Final = 1
START_STREAM: Final = 2
CAMERA_STREAM: Final = 3
"""First counter of this room's draws; other rooms take numbers from 16 on for their own."""

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_SHIFT_30 = np.uint64(30)
_SHIFT_27 = np.uint64(27)
_SHIFT_31 = np.uint64(31)
_SHIFT_11 = np.uint64(11)
_SHIFT_16 = np.uint64(16)
_SHIFT_32 = np.uint64(32)
_SHIFT_48 = np.uint64(48)
_LOW_16 = np.uint64(0xFFFF)
_TO_UNIT = 2.0**-53

_FOUR_PARTS_MEAN = 4 * 32767.5
_FOUR_PARTS_SCALE = 1.0 / (4 * (65536.0**2 - 1.0) / 12.0) ** 0.5


@kernel
def mix(state: np.uint64) -> np.uint64:
    """One splitmix64 output: uint64 -> uint64, a bijection."""
    z = state + _GOLDEN
    z = (z ^ (z >> _SHIFT_30)) * _FIRST
    z = (z ^ (z >> _SHIFT_27)) * _SECOND
    return z ^ (z >> _SHIFT_31)


@kernel
def key_of(seed: int, a: int, b: int, c: int) -> np.uint64:
    """64 random bits of the counters (a, b, c) under a seed; all are integers of at most 64 bits."""
    return mix(mix(mix(mix(np.uint64(seed)) + np.uint64(a)) + np.uint64(b)) + np.uint64(c))


@kernel
def uniform(seed: int, a: int, b: int, c: int) -> float:
    """Uniform in [0, 1), 53 bits."""
    return np.float64(key_of(seed, a, b, c) >> _SHIFT_11) * _TO_UNIT


@kernel
def gaussian_of(bits: np.uint64) -> float:
    """Mean 0, standard deviation 1, from 64 random bits: the sum of four 16-bit parts, so never beyond 3.47."""
    parts = (bits & _LOW_16) + ((bits >> _SHIFT_16) & _LOW_16) + ((bits >> _SHIFT_32) & _LOW_16) + (bits >> _SHIFT_48)
    return (np.float64(np.int64(parts)) - _FOUR_PARTS_MEAN) * _FOUR_PARTS_SCALE


@kernel
def gaussian(seed: int, a: int, b: int, c: int) -> float:
    """Mean 0, standard deviation 1; see `gaussian_of`."""
    return gaussian_of(key_of(seed, a, b, c))
