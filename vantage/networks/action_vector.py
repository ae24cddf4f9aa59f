"""The planned path as a vector, for the baselines that are told of the plan without pictures (paper, Table I).

121 numbers: 40 slots of x, y, presence, then horizon / 400. Slot i holds the position at step min(10 (i + 1), horizon), so that
the last slot present always holds the end of the path; where the path begins, the view shows. x and y run from -1 to 1 over
the arena; positions outside are moved to its edge, as F and T draw them. Slots past the end are zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vantage.compiled import kernel
from vantage.perception.action_maps import SCALE_STEPS
from vantage.world.arena import ARENA_SIZE

SPACING = 10
"""Steps between two slots."""
SLOTS = SCALE_STEPS // SPACING
VECTOR_LENGTH = SLOTS * 3 + 1


@kernel
def render_vectors(
    positions: NDArray[np.floating],  # [N, 2 or more] x, y in m, one path after the other
    first: NDArray[np.int64],  # [B] row of `positions` at step 0
    horizons: NDArray[np.int64],  # [B] steps, 0..400
    symmetries: NDArray[np.int64],  # [B] 0..7, as `transform_path`
    out: NDArray[np.float32],  # [B, 121]
) -> None:
    """Render B paths from step 0 to their horizons. Raises ValueError where a path ends before its horizon, or a horizon is not
    0 to 400."""
    out[:] = 0.0
    for b in range(first.shape[0]):
        horizon, symmetry = horizons[b], symmetries[b]
        if horizon < 0 or horizon > SCALE_STEPS:
            raise ValueError("an action vector reaches 0 to 400 steps")
        if first[b] < 0 or first[b] + horizon >= positions.shape[0]:
            raise ValueError("an action vector needs positions up to its horizon")
        for slot in range(max(1, (horizon + SPACING - 1) // SPACING)):
            row = first[b] + min(SPACING * (slot + 1), horizon)
            x = min(1.0, max(-1.0, 2.0 * positions[row, 0] / ARENA_SIZE - 1.0))
            y = min(1.0, max(-1.0, 2.0 * positions[row, 1] / ARENA_SIZE - 1.0))
            if symmetry >= 4:
                x = -x
            for _ in range(symmetry % 4):
                x, y = -y, x
            out[b, 3 * slot] = x
            out[b, 3 * slot + 1] = y
            out[b, 3 * slot + 2] = 1.0
        out[b, VECTOR_LENGTH - 1] = horizon / SCALE_STEPS
