"""Compression of chunks. Decompression is bounded by the size that a chunk declares: a stranger's chunk may be a bomb."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import lz4.frame
import zstandard

Compression = Literal["zstd", "lz4", "none"]

LARGEST_CHUNK = 1 << 28
"""Bytes of a decompressed chunk above which it is refused: one message is in one chunk, and the bus carries 100 MB at most."""

COMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": lambda data: zstandard.ZstdCompressor(level=1).compress(data),
    "lz4": lz4.frame.compress,
}


def decompress(stored: bytes, compression: str, size: int) -> bytes:
    """Return the `size` bytes that a chunk holds; no more than that is ever decompressed.

    Args:
        compression: as the chunk names it; empty: stored as it is.
        size: bytes that the chunk declares.

    Raises:
        ValueError: it declares more than `LARGEST_CHUNK`, holds another number of bytes, or names an unknown compression.
        RuntimeError, zstandard.ZstdError: the compressed bytes are damaged.
    """
    if size > LARGEST_CHUNK:
        raise ValueError(f"chunk claims {size} bytes")
    match compression:
        case "":
            data = stored
        case "lz4":
            # One byte more than declared, to see a chunk that holds more.
            data = lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1)
        case "zstd":
            # The size in the frame's own head is a claim, too: only streaming keeps to a limit.
            with zstandard.ZstdDecompressor().stream_reader(stored, read_across_frames=True) as reader:
                data = reader.read(size + 1)
        case other:
            raise ValueError(f"unknown compression {other[:40]!r}")
    if len(data) != size:
        raise ValueError(f"chunk claims {size} bytes and holds {'more' if len(data) > size else len(data)}")
    return data
