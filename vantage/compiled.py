"""How kernels are compiled: numba in nopython mode, cached on disk under a hash of every kernel's source.

numba's own cache does not notice that a kernel in *another* module changed. The cache folder is therefore named after
the content of all rooms that hold kernels: any edit there starts a fresh cache.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache

from vantage.errors import explain

_ROOT = Path(__file__).resolve().parent.parent
_ROOMS = (
    *("schemas", "vantage/world", "vantage/perception", "vantage/networks"),
    *("vantage/tracking", "vantage/rehearsal"),
    *("services/seeker", "services/planner", "learning/hiders", "learning/roll_outs"),
)


def _source_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode() + Path(__file__).read_bytes())
    for room in _ROOMS:
        for path in sorted((_ROOT / room).glob("*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _own_folder(folder: Path) -> bool:
    """Make a folder if it is missing; return whether this process can write to it and no other user can.

    Cached kernels are machine code: a folder that somebody else may write to would run their code.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
    except OSError:
        return False
    return found.st_uid == os.getuid() and not found.st_mode & 0o022 and os.access(folder, os.W_OK | os.X_OK)


def cache_folder(environment: Mapping[str, str] = os.environ, temporary: Path = Path("/tmp")) -> Path | None:
    """Return the folder of the compiled kernels: the first of these that this user can write to, None without one.

    `NUMBA_CACHE_DIR`, `XDG_CACHE_HOME`, `~/.cache`, and a private folder in `/tmp`.
    """
    name = Path("vantage", "kernels", _source_hash())
    if chosen := environment.get("NUMBA_CACHE_DIR"):
        return Path(chosen) / name
    bases = [Path(cache)] if (cache := environment.get("XDG_CACHE_HOME")) else []
    if home := environment.get("HOME"):
        bases.append(Path(home) / ".cache")
    for folder in (*(base / name for base in bases), temporary / f"vantage-kernels-{os.getuid()}" / name.name):
        if _own_folder(folder.parent) and _own_folder(folder):
            return folder
    return None


class _KernelCache(FunctionCache):
    """numba's cache, which never ends a program: what cannot be read is compiled again, what cannot be written is not kept."""

    _warned = False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # emptied or cut off by a power failure: whatever the unpickler makes of it
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except OSError as error:
            if not _KernelCache._warned:
                _KernelCache._warned = True
                print(f"kernels are compiled at each start, which takes a minute: {explain(error)}", file=sys.stderr)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function: deterministic floating point, releases the GIL, division by zero gives inf or NaN."""
    dispatcher = numba.njit(fastmath=False, nogil=True, error_model="numpy")(function)
    if _CACHE is not None:
        with contextlib.suppress(OSError, RuntimeError):  # numba finds no place to write to
            dispatcher._cache = _KernelCache(function)
    return dispatcher


_CACHE = cache_folder()
if _CACHE is None:
    print("kernels are compiled at each start, which takes a minute: neither ~/.cache nor /tmp can be written", file=sys.stderr)
else:
    numba.config.CACHE_DIR = str(_CACHE)
