"""Where an export goes: files and folders that appear under their name only when they are whole."""

from __future__ import annotations

import importlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Progress = Callable[[str, float], None]
"""Told what is being done, and how far it is: 0 to 1."""


def in_silence(_what: str, _part: float) -> None:
    """Progress that nobody wants to see."""


class ExportError(Exception):
    """Why a log cannot be exported, and what to do, for people."""

    for_people = True


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


@contextmanager
def whole(target: Path, *, force: bool = False, is_ours: Callable[[Path], bool] = lambda _: False) -> Iterator[Path]:
    """Yield a place beside `target` to write a file or a folder to; it gets its name when the block ends without an error.

    What the block leaves when it fails is removed; a process that is killed leaves at most a hidden `.NAME.partial-*`.

    Args:
        force: replace a file of that name, or a folder that `is_ours`.
        is_ours: whether a folder is an earlier export; no other folder is ever replaced.

    Raises:
        TargetExists: see `force`.
        OSError: the disk.
    """
    _require_free(target, force, is_ours)
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.stem}.partial-{os.getpid()}{target.suffix}")
    _remove(partial)
    try:
        yield partial
        _require_free(target, force, is_ours)
        if target.is_dir():
            old = target.with_name(f".{target.stem}.old-{os.getpid()}")
            target.rename(old)
            partial.rename(target)
            _remove(old)
        else:
            partial.replace(target)
    finally:
        _remove(partial)


def _require_free(target: Path, force: bool, is_ours: Callable[[Path], bool]) -> None:
    if not target.exists():
        return
    if not force:
        raise TargetExists(target)
    if target.is_dir() and any(target.iterdir()) and not is_ours(target):
        raise TargetExists(target, "a folder that is no earlier export of this format is never replaced; choose another --output")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
