"""Coordinate-value is told of the plan exactly what its variant declares."""

import numpy as np
import pytest
import torch

from vantage.networks.action_vector import VECTOR_LENGTH, render_vectors
from vantage.networks.coordinate_value import CoordinateValue, CoordinateValueSettings, end_of


def vectors(seed: int, horizons: list[int]) -> tuple[np.ndarray, torch.Tensor]:
    count = len(horizons)
    positions = np.random.default_rng(seed).uniform(0, 1.2, (count * 401, 3)).astype(np.float32)
    first, out = np.arange(count) * 401, np.empty((count, VECTOR_LENGTH), np.float32)
    render_vectors(positions, first, np.array(horizons), np.zeros(count, np.int64), out)
    return positions[first + np.array(horizons), :2], torch.from_numpy(out)


def test_the_end_of_a_vector_is_where_the_path_ends() -> None:
    ends, told = vectors(0, [0, 1, 9, 10, 11, 123, 399, 400])
    np.testing.assert_allclose(end_of(told).numpy(), ends / 0.6 - 1, atol=1e-6)


@pytest.mark.parametrize("variant", ["path", "end"])
def test_only_the_variant_path_knows_how_the_hider_gets_there(variant: str) -> None:
    torch.manual_seed(0)
    settings = CoordinateValueSettings(variant=variant, encoder=(4,) * 8, reduced=4, hidden=8)  # type: ignore[arg-type]
    network = CoordinateValue(settings).eval()
    view = torch.rand(1, 3, 128, 128).expand(2, -1, -1, -1)
    _, told = vectors(1, [60, 60])
    told[1, 15:18] = told[0, 15:18]  # the same end, another way
    with torch.no_grad():
        one, other = network(view, told)
        told[1, 15] += 0.5
        elsewhere = network(view, told)[1]
    assert bool(one == other) == (variant == "end")
    assert elsewhere != other
