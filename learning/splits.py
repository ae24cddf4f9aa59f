"""Which split an episode belongs to: decided by its seed alone, so that nobody can mix them up later."""

from __future__ import annotations

import hashlib
from typing import Literal

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")


def split_of(seed: int) -> int:
    """Return the split (index into SPLITS) of an episode: 8 in 10 train, 1 validation, 1 test, by a hash of its seed."""
    tenth = int.from_bytes(hashlib.sha256(f"split {seed}".encode()).digest()[:8], "little") % 10
    return 0 if tenth < 8 else tenth - 7
