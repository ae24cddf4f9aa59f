"""The emulated table of the benchmarks, for tests."""

import sys
from pathlib import Path

_BENCHMARKS = str(Path(__file__).resolve().parents[2] / "benchmarks")
if _BENCHMARKS not in sys.path:
    sys.path.insert(0, _BENCHMARKS)

import driver  # noqa: E402
from emulated_table import EmulatedTable, TrackerSettings  # noqa: E402

__all__ = ["EmulatedTable", "TrackerSettings", "driver"]
