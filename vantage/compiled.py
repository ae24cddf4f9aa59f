"""How kernels are compiled: numba in nopython mode, cached on disk under a hash of every kernel's source.

numba's own cache does not notice that a kernel in *another* module changed. The cache folder is therefore named after
the content of all rooms that hold kernels: any edit there starts a fresh cache.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numba

_ROOT = Path(__file__).resolve().parent.parent
_ROOMS = (
    *("schemas", "vantage/world", "vantage/perception", "vantage/networks"),
    *("vantage/tracking", "vantage/rehearsal"),
    *("services/seeker", "services/planner", "learning/hiders", "learning/roll_outs"),
)


def _source_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for room in _ROOMS:
        for path in sorted((_ROOT / room).glob("*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


numba.config.CACHE_DIR = str(Path.home() / ".cache" / "vantage" / "kernels" / _source_hash())

kernel: Any = numba.njit(cache=True, fastmath=False, nogil=True, error_model="numpy")
"""Decorator of a compiled kernel: deterministic floating point, releases the GIL, division by zero gives inf or NaN."""
