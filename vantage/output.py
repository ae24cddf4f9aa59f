"""Results on disk: files and folders that get their final name only when they are complete."""

from __future__ import annotations

import glob
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vantage.errors import UserError

_PARTIAL = re.compile(r"^\.(?P<target>.*)\.(?P<kind>partial|old)-(?P<process>\d+)")


class AlreadyExists(UserError):
    """A result would overwrite something."""

    def __init__(self, path: Path, remedy: str = "choose another name, or move it away") -> None:
        super().__init__(f"{path} exists already: {remedy}")


def refuse_existing(*targets: Path, force: bool) -> None:
    """Raise before a long computation where its results would overwrite something.

    Raises:
        AlreadyExists: one of the targets exists, and not `force`.
    """
    for target in targets:
        if not force and os.path.lexists(target):
            raise AlreadyExists(target, "choose another --to, or replace it with --force")


def partial_name(target: Path) -> Path:
    """Return the hidden name beside `target` under which this process writes it."""
    # Whole names: results that differ by their ending alone may be written side by side.
    return target.with_name(_beginning(target) + target.suffix)


@contextmanager
def complete(target: Path, *, replace: bool = True) -> Iterator[Path]:
    """Yield a path beside `target` to write a file or a folder to; it is renamed to `target` when the block succeeds.

    When the block fails, what it wrote is removed, including files whose names begin with the yielded one's. A process that is
    killed leaves at most a hidden `.NAME.partial-PID`, which `remove_abandoned` finds.

    Args:
        replace: whether `target` may exist; it is then replaced in one step (a folder in two).

    Raises:
        AlreadyExists: see `replace`.
        OSError: of the disk; it names the target.
    """
    if not replace and os.path.lexists(target):
        raise AlreadyExists(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.is_symlink():
        target = Path(os.path.realpath(target))
    partial = partial_name(target)
    _remove_own(target)
    try:
        yield partial
        if not replace and os.path.lexists(target):
            raise AlreadyExists(target)
        _sync(partial)
        if target.is_dir() and not target.is_symlink():
            old = target.with_name(f".{target.name}.old-{os.getpid()}")
            target.rename(old)
            try:
                partial.rename(target)
            except BaseException:
                old.rename(target)
                raise
            _remove(old)
        else:
            partial.replace(target)
    except OSError as error:
        of_ours = error.filename is None or str(error.filename).startswith(str(target.with_name(_beginning(target))))
        if error.errno is None or not of_ours:
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(target)) from error
    finally:
        _remove_own(target)


def write_complete(target: Path, content: str | bytes, *, replace: bool = True) -> None:
    """Write a file in one step; see `complete`."""
    with complete(target, replace=replace) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


def remove_abandoned(folder: Path) -> None:
    """Remove partial results in `folder` of processes that no longer live; what one had moved aside goes back to its name."""
    for path in folder.glob(".*-*"):
        found = _PARTIAL.match(path.name)
        if found is None or Path(f"/proc/{found['process']}").exists():
            continue
        target = path.with_name(found["target"])
        if found["kind"] == "old" and not os.path.lexists(target):
            path.rename(target)
        else:
            _remove(path)


def _sync(path: Path) -> None:
    if path.is_file():
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _beginning(target: Path) -> str:
    """Return the beginning of the names of all that this process writes for `target`."""
    return f".{target.name}.partial-{os.getpid()}"


def _remove_own(target: Path) -> None:
    beginning = _beginning(target)
    for path in target.parent.glob(f"{glob.escape(beginning)}*"):
        if not path.name[len(beginning) :][:1].isdigit():  # else of a process with a longer number
            _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
