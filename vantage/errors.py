"""Errors that are for the person at the terminal, and the one place that words errors of the operating system for them."""

from __future__ import annotations

import errno
import os

_REMEDIES = {
    errno.ENOSPC: "free some space, then run it again",
    errno.EDQUOT: "your quota is used up: free some space, then run it again",
    errno.EROFS: "choose a folder on a disk that can be written",
    errno.EACCES: "choose another place, or change its permissions",
    errno.EPERM: "choose another place, or change its permissions",
    errno.EEXIST: "choose another name, or move it away",
    errno.ENOTDIR: "a part of this path is a file: choose another place",
    errno.EISDIR: "it is a folder where a file is expected",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.EMFILE: "raise the limit on open files: ulimit -n 4096",
    errno.ENFILE: "the machine has too many open files: close other programs",
    errno.ENOMEM: "close other programs, or use a machine with more memory",
}


class UserError(Exception):
    """An error whose text says what is wrong and what to do about it.

    Commands print it as one line and exit with 1; any exception that is neither this nor of the operating system is a bug and
    keeps its traceback.
    """


def explain(error: BaseException) -> str | None:
    """Return the line that a person should see for an error; None for a bug, which wants its traceback."""
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, OSError) and error.errno is not None:
        # Errors of name look-ups have negative numbers of their own.
        reason = os.strerror(error.errno) if error.errno > 0 else str(error.strerror)
        names = [os.fsdecode(name) for name in (error.filename, error.filename2) if isinstance(name, str | bytes)]
        remedy = _REMEDIES.get(error.errno)
        return ": ".join((*names[:1], reason)) + (f"; {remedy}" if remedy else "")
    if isinstance(error, MemoryError):
        return "out of memory; close other programs, or ask for less at a time"
    return None
