"""Where an export goes: files and folders that appear under their name only when they are whole."""

from __future__ import annotations

import glob
import importlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vantage.errors import UserError

Progress = Callable[[str, float], None]
"""Told what is being done, and how far it is: 0 to 1."""


def in_silence(_what: str, _part: float) -> None:
    """Progress that nobody wants to see."""


class ExportError(UserError):
    """Why a log cannot be exported, and what to do, for people."""


class TargetExists(ExportError):
    """The target is there already."""

    def __init__(self, path: Path, hint: str = "choose another name with --output, or replace it with --force") -> None:
        super().__init__(f"{path} exists already: {hint}")


def optional(module: str, package: str) -> Any:
    """Return a module of the extra `viewers`.

    Raises:
        ExportError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        if error.name is not None and not module.startswith(error.name):
            raise
        raise ExportError(
            f"{package} is not installed, which this format is written with: pip install 'vantage-hide-and-seek[viewers]'"
        ) from error


IsOurs = Callable[[Path], bool]
"""Whether what lies at a target is an earlier export of the same format, which alone may be replaced."""


def begins_with(magic: bytes, at: int = 0) -> IsOurs:
    """Return what tells a file by the bytes that its format has at byte `at`."""

    def is_ours(path: Path) -> bool:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(at + len(magic))[at:] == magic

    return is_ours


def require_free(target: Path, force: bool, is_ours: IsOurs, sources: Iterable[Path] = ()) -> None:
    """Check that an export may be written to `target`.

    Args:
        force: replace an earlier export.
        is_ours: nothing else is ever replaced, but an empty folder.
        sources: files that are being read, which are never replaced.

    Raises:
        TargetExists: see `force`.
        ExportError: the target is a source.
    """
    if not target.exists():
        return
    if any(source.exists() and target.samefile(source) for source in sources):
        raise ExportError(f"{target} is the log itself, which is never replaced: choose another --output")
    if is_ours(target) or (target.is_dir() and not any(target.iterdir())):
        if not force:
            raise TargetExists(target)
        return
    raise TargetExists(target, "it is no earlier export of this format, so it is never replaced; choose another --output")


@contextmanager
def whole(
    target: Path, *, force: bool = False, is_ours: IsOurs = lambda _: False, sources: Iterable[Path] = ()
) -> Iterator[Path]:
    """Yield a place beside `target` to write a file or a folder to; it gets its name when the block ends without an error.

    What the block leaves when it fails is removed, also files that begin with the name of the place; a process that is killed
    leaves at most a hidden `.NAME.partial-*`.

    Args:
        force, is_ours, sources: see `require_free`.

    Raises:
        TargetExists, ExportError: see `require_free`.
        OSError: the disk; it names the target.
    """
    sources = tuple(sources)
    require_free(target, force, is_ours, sources)
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.stem}.partial-{os.getpid()}{target.suffix}")
    _remove_all(partial)
    try:
        yield partial
        require_free(target, force, is_ours, sources)
        if target.is_dir():
            old = target.with_name(f".{target.stem}.old-{os.getpid()}")
            target.rename(old)
            partial.rename(target)
            _remove(old)
        else:
            partial.replace(target)
    except OSError as error:
        if error.errno is None or not (error.filename is None or str(error.filename).startswith(str(partial.with_suffix("")))):
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(target)) from error
    finally:
        _remove_all(partial)


def _remove_all(partial: Path) -> None:
    """Remove a place, and the parts that a writer began beside it."""
    for path in partial.parent.glob(f"{glob.escape(partial.stem)}*"):
        _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
