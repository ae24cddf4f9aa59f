"""Where an export goes: files and folders that appear under their name only when they are whole."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vantage.errors import UserError
from vantage.output import AlreadyExists, complete

Progress = Callable[[str, float], None]
"""Told what is being done, and how far it is: 0 to 1."""


def in_silence(_what: str, _part: float) -> None:
    """Progress that nobody wants to see."""


class ExportError(UserError):
    """Why a log cannot be exported, and what to do, for people."""


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
        AlreadyExists: see `force`.
        ExportError: the target is a source.
    """
    if not target.exists():
        return
    if any(source.exists() and target.samefile(source) for source in sources):
        raise ExportError(f"{target} is the log itself, which is never replaced: choose another --to")
    if is_ours(target) or (target.is_dir() and not any(target.iterdir())):
        if not force:
            raise AlreadyExists(target, "choose another name with --to, or replace it with --force")
        return
    raise AlreadyExists(target, "it is no earlier export of this format, so it is never replaced; choose another --to")


@contextmanager
def whole(
    target: Path, *, force: bool = False, is_ours: IsOurs = lambda _: False, sources: Iterable[Path] = ()
) -> Iterator[Path]:
    """Yield a place beside `target` to write a file or a folder to; see `vantage.output.complete`.

    Args:
        force, is_ours, sources: see `require_free`.

    Raises:
        AlreadyExists, ExportError: see `require_free`.
        OSError: of the disk; it names the target.
    """
    sources = tuple(sources)
    require_free(target, force, is_ours, sources)
    with complete(target) as partial:
        yield partial
        require_free(target, force, is_ours, sources)
