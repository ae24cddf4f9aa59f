"""Opening a closed Zenoh session: unix sockets in a private folder, no multicast, no TCP."""

from __future__ import annotations

import json
import os
from pathlib import Path

import zenoh

from vantage.bus.interface import CannotOpen, NameInUse
from vantage.bus.names import is_held, living_names
from vantage.private_folder import NotPrivate, make_private

LEASE = 10.0
"""Seconds without a sign of life after which a peer's connection is closed (a peer that dies is seen at once).

No shorter: when a stopped process comes back just as its connection is closed, Zenoh (1.9, 1.10.2) now and then deletes the new
connection along with the old one, which nothing but a restart of a process repairs. Stops up to three quarters of it are safe.
"""

_LONGEST_SOCKET_PATH = 107  # sockaddr_un.sun_path holds 108 bytes, the last of them zero


def open_session(name: str, folder: Path, known: frozenset[str]) -> zenoh.Session:
    """Open a participant's session on the sockets in `folder`, which is made (mode 0700) when it does not exist.

    Args:
        known: who may publish or serve, by the tables; see `connections`.

    Raises:
        NameInUse: a living process holds the socket of that name.
        CannotOpen: the folder is not private, its path is too long for a socket, or Zenoh refuses.
    """
    folder = Path(os.path.abspath(folder))
    _check_path(name, folder)
    try:
        make_private(folder)
    except NotPrivate as error:
        raise CannotOpen(str(error)) from None
    except OSError as error:
        raise CannotOpen(f"cannot make the folder for sockets {folder}: {error.strerror}") from error
    _refuse_taken_name(name, folder)
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(configuration(name, folder, known))))
    except zenoh.ZError as error:
        _refuse_taken_name(name, folder)
        raise CannotOpen(f"Zenoh does not open a session for {name!r} in {folder}: {error}") from error


def configuration(name: str, folder: Path, known: frozenset[str]) -> dict[str, object]:
    """Return the Zenoh configuration of one participant."""
    return {
        "mode": "peer",
        "listen": {"endpoints": [_endpoint(name, folder)], "exit_on_failure": True},
        "connect": {
            "endpoints": [_endpoint(other, folder) for other in connections(name, folder, known)],
            "exit_on_failure": False,
            "retry": {"period_init_ms": 100, "period_max_ms": 250, "period_increase_factor": 1.5},
        },
        "scouting": {"delay": 0, "multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "timestamping": {"enabled": True},
        "transport": {
            # Nobody waits long for a process that is stopped in the middle of its greeting.
            "unicast": {"open_timeout": 2000, "accept_timeout": 2000},
            # Shared memory is slower than the socket below 100 KB, and a killed process leaves its segments behind.
            "shared_memory": {"enabled": False},
            "link": {
                "protocols": ["unixsock-stream"],
                "tx": {
                    "lease": round(1000 * LEASE),
                    # Signs of life twice a second; to close a session to a stopped process takes as long.
                    "keep_alive": round(2 * LEASE),
                    "queue": {
                        "size": {"data": 16},
                        # A batch goes as soon as the link is free: waiting for it to fill costs up to a millisecond, and
                        # a batch for each message (express) fills the queue with 16 small ones.
                        "batching": {"enabled": True, "time_limit": 0},
                    },
                },
            },
        },
    }


def connections(name: str, folder: Path, known: frozenset[str]) -> list[str]:
    """Return to whom a participant connects, for as long as it lives: of each two, always the same one connects to the other.

    If both did (as with gossip, or fixed hubs), one may come back over a new connection while the other still holds the old one
    for alive; Zenoh then joins the two, and messages arrive under wrong keys. So the known connect to those before them in the
    alphabet, and everybody else (who only listens) to all the known, and to the unknown that are there.
    """
    if name in known:
        return sorted(other for other in known if other < name)
    return sorted((known | set(living_names(folder))) - {name})


def _endpoint(name: str, folder: Path) -> str:
    return f"unixsock-stream/{folder / name}.sock"


def _check_path(name: str, folder: Path) -> None:
    path = f"{folder / name}.sock"
    length = len(os.fsencode(path))
    if length > _LONGEST_SOCKET_PATH:
        raise CannotOpen(
            f"{path} is too long for a socket ({length} bytes, at most {_LONGEST_SOCKET_PATH}): choose a shorter folder"
        )
    if any(sign in path for sign in "#?;"):
        raise CannotOpen(f"{path}: a folder for sockets must not have `#`, `?` or `;` in its path")


def _refuse_taken_name(name: str, folder: Path) -> None:
    if is_held(Path(f"{folder / name}.sock.lock")):
        raise NameInUse(f"{name!r} is on the bus in {folder} already: stop that process first")
