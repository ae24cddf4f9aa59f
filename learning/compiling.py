"""Whether to compile a network before it is trained."""

from __future__ import annotations

import os
import shutil
from importlib.util import find_spec
from typing import Literal

import torch

Compile = Literal["auto", "on", "off"]

_WORTH_IT = {"cpu": 100_000, "cuda": 2_000_000}
"""Samples from which on compiling saves more than the minute or two it takes (measured on one CPU core: a third faster)."""
_WORTH_IT_MINUTES = 15.0


def to_compile(wanted: Compile, device: torch.device, samples: int, minutes: float | None) -> tuple[bool, str]:
    """Return whether to compile the network of a training of so many samples, or minutes, and why, for people."""
    if wanted != "auto":
        return wanted == "on", f"compiling is {wanted}, as asked"
    if samples < _WORTH_IT.get(device.type, 0) if minutes is None else minutes < _WORTH_IT_MINUTES:
        return False, "not compiled: too short a training to be worth it"
    if device.type == "cuda":
        missing = None if find_spec("triton") and _found("CC", "cc", "gcc", "clang") else "triton or a C compiler"
    else:
        missing = None if _found("CXX", "g++", "clang++") else "a C++ compiler"
    if missing:
        return False, f"not compiled: {missing} is missing; with g++ a CPU learns a third faster"
    return True, "compiling the network takes a minute or two (--compile off goes without)"


def _found(variable: str, *names: str) -> bool:
    return any(map(shutil.which, (os.environ.get(variable, names[0]), *names)))
