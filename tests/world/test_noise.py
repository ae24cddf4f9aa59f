"""The counter-based random numbers: the published generator, and even, uncorrelated draws."""

from __future__ import annotations

import numpy as np
import pytest

from vantage.world.noise import gaussian, mix, uniform


def test_mixing_is_splitmix64() -> None:
    # First outputs of the reference implementation (prng.di.unimi.it/splitmix64.c) for state 0 and state 1234567.
    golden = 0x9E3779B97F4A7C15
    assert [int(mix(np.uint64(i * golden % 2**64))) for i in range(3)] == [
        0xE220A8397B1DCDAF,
        0x6E789E6AA1B965F4,
        0x06C45D188009454F,
    ]
    assert [int(mix(np.uint64((1234567 + i * golden) % 2**64))) for i in range(2)] == [6457827717110365317, 3203168211198807973]


@pytest.mark.parametrize("counter", [0, 1, 2, 3])
def test_uniform_fills_the_unit_interval_along_every_counter(counter: int) -> None:
    arguments = [[7, 1, 2, 3] for _ in range(40_000)]
    for i, row in enumerate(arguments):
        row[counter] = i
    draws = np.array([uniform(*row) for row in arguments])
    assert draws.min() >= 0.0
    assert draws.max() < 1.0
    counts = np.histogram(draws, bins=64, range=(0.0, 1.0))[0]
    chi_square = ((counts - 625.0) ** 2 / 625.0).sum()
    assert chi_square < 120.0  # 63 degrees of freedom: beyond 99.99 %
    assert abs(np.corrcoef(draws[:-1], draws[1:])[0, 1]) < 0.02


def test_gaussian_has_its_moments() -> None:
    draws = np.array([gaussian(3, 4, 5, i) for i in range(60_000)])
    assert abs(draws.mean()) < 0.02
    assert draws.std() == pytest.approx(1.0, abs=0.02)
    assert abs((draws**3).mean()) < 0.05
    assert np.abs(draws).max() < 3.47
    assert (np.abs(draws) < 1.0).mean() == pytest.approx(0.683, abs=0.02)


def test_the_order_of_draws_does_not_matter_and_large_seeds_are_fine() -> None:
    forward = [uniform(2**63 - 1, 1, i, 0) for i in range(50)]
    backward = [uniform(2**63 - 1, 1, i, 0) for i in reversed(range(50))]
    assert forward == backward[::-1]
    assert len(set(forward)) == 50
    assert uniform(2**63 - 1, 1, 0, 0) != uniform(2**63 - 2, 1, 0, 0)
