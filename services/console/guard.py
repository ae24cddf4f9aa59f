"""Who may talk to the web server: pure judgements about one request's headers."""

from __future__ import annotations

import hmac
import ipaddress
import os
import secrets
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from vantage.deployment import CONSOLE_TOKEN

LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
PROTOCOL = "vantage"
"""WebSocket subprotocol of the page."""

SECURITY_HEADERS = (
    (b"content-security-policy", b"default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)


def host_name(host: str) -> str:
    """Return the name or address in a Host header, without port and brackets, in small letters."""
    host = host.strip().lower()
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]


@dataclass(frozen=True)
class Guard:
    """Judges requests.

    Attributes:
        bound: the address the server listens on.
        token: what a WebSocket must offer, also on loopback: other users of the machine reach that, too.
    """

    bound: str
    token: str

    def refusal(self, hosts: list[str], origins: list[str], upgrade: bool) -> str:
        """Return why a request is refused, empty when it is not.

        Args:
            hosts, origins: all values of these headers.
            upgrade: whether it asks for a WebSocket; a browser always says from which page it does.
        """
        if len(hosts) != 1 or not self.knows(hosts[0]):
            return "wrong host"
        if not origins:
            return "no origin" if upgrade else ""
        if len(origins) != 1 or origins[0].lower() not in {f"{scheme}://{hosts[0].lower()}" for scheme in ("http", "https")}:
            return "wrong origin"
        return ""

    def knows(self, host: str) -> bool:
        """Return whether a Host header names this server: a name that somebody else's DNS may point here does not."""
        name = host_name(host)
        if name in LOOPBACK or name == self.bound.lower():
            return True
        if self.bound not in ("0.0.0.0", "::", ""):
            return False
        if name in {socket.gethostname().lower(), f"{socket.gethostname().lower()}.local"}:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    def admits(self, subprotocols: Iterable[str]) -> bool:
        """Return whether a WebSocket offers the token as one of its subprotocols."""
        return any(hmac.compare_digest(name.encode(), self.token.encode()) for name in subprotocols)


def token_of(folder: Path) -> str:
    """Return the token kept in a folder; made, readable by its owner alone, at the first call.

    Raises:
        OSError: it can be neither read nor made.
    """
    path = folder / CONSOLE_TOKEN
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(secrets.token_urlsafe(24))
    except FileExistsError:
        pass
    token = path.read_text().strip()
    if not token:
        raise OSError(f"{path} is empty: remove it, and a new token is made")
    return token
