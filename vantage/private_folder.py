"""Folders that no other user of the machine can enter, change or replace: for sockets, tokens and files that are executed."""

from __future__ import annotations

import contextlib
import grp
import os
import pwd
import stat
from pathlib import Path

from vantage.errors import UserError

_OPEN = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_MOST_LINKS = 40


class NotPrivate(UserError):
    """Another user can enter, change or replace a folder; the text names it and the remedy."""


def make_private(folder: Path) -> None:
    """Make a folder of mode 0700, with its parents, or accept one that is there and private, as in `is_private`.

    Raises:
        NotPrivate: it is there and not private, or a folder above it can be changed by another user.
        OSError: it cannot be made.
    """
    _walk(Path(os.path.abspath(folder)), make=True)


def is_private(folder: Path) -> bool:
    """Return whether a folder exists, which is then private.

    Every folder on the way is opened below the one before and must belong to this user or to root, and be writable by no one
    else unless it is sticky (as /tmp is). Others can then neither put something in its place nor change that, so that paths
    through it lead to the same files from here on.

    Raises:
        NotPrivate: it exists, but another user can enter, change or replace it.
    """
    return _walk(Path(os.path.abspath(folder)), make=False)


def _walk(folder: Path, make: bool) -> bool:
    owners = {0, os.geteuid(), os.stat("/").st_uid}  # whoever owns the root directory can do anything
    names = list(reversed(folder.parts[1:]))
    place = Path("/")
    links = 0
    here = os.open("/", _OPEN)
    try:
        while names:
            name = names.pop()
            if name == "..":  # of a link's target
                place = place.parent
                here = _replaced(here, os.open("..", _OPEN, dir_fd=here))
                continue
            place /= name
            try:
                found = os.stat(name, dir_fd=here, follow_symlinks=False)
            except FileNotFoundError:
                if not make:
                    return False
                with contextlib.suppress(FileExistsError):  # made by someone at the same time: then its owner decides
                    os.mkdir(name, 0o700, dir_fd=here)
                found = os.stat(name, dir_fd=here, follow_symlinks=False)
            if found.st_uid not in owners:
                raise NotPrivate(
                    f"{place} belongs to user {found.st_uid}, not to you ({os.geteuid()}): choose another folder (--folder)"
                )
            if stat.S_ISLNK(found.st_mode) and names and links < _MOST_LINKS:
                links += 1
                target = Path(os.readlink(name, dir_fd=here))
                place = place.parent
                if target.is_absolute():
                    place = Path("/")
                    here = _replaced(here, os.open("/", _OPEN))
                names += reversed([part for part in target.parts if part != "/"])
                continue
            if not stat.S_ISDIR(found.st_mode):
                raise NotPrivate(f"{place} is not a folder of its own (a link?): choose another folder (--folder)")
            here = _replaced(here, os.open(name, _OPEN, dir_fd=here))
            _check_mode(os.fstat(here), place, last=not names)
        return True
    finally:
        os.close(here)


def _replaced(old: int, new: int) -> int:
    os.close(old)
    return new


def _check_mode(found: os.stat_result, place: Path, last: bool) -> None:
    mode = stat.S_IMODE(found.st_mode)
    if last:
        if found.st_uid != os.geteuid():
            raise NotPrivate(
                f"{place} belongs to user {found.st_uid}, not to you ({os.geteuid()}): choose another folder (--folder)"
            )
        if mode & 0o077:
            raise NotPrivate(
                f"{place} is open to other users (mode {mode:04o}): `chmod 700 {place}`, or choose another folder (--folder)"
            )
        return
    others = 0o002 if _is_own_group(found.st_gid) else 0o022
    if mode & others and not mode & stat.S_ISVTX:
        raise NotPrivate(
            f"{place} can be changed by other users (mode {mode:04o}): `chmod go-w {place}`, or choose another folder (--folder)"
        )


def _is_own_group(number: int) -> bool:
    """Return whether a group is this user's alone, as most distributions make one for each user."""
    try:
        name, group = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(number)
    except KeyError:
        return False
    return group.gr_name == name and set(group.gr_mem) <= {name}
