"""Hostile requests to the console of all kinds, and how it may answer each."""

from __future__ import annotations

import contextlib
import json
import random
import struct
from collections import Counter
from collections.abc import Callable

from tests.services.console_socket import (
    BINARY,
    CLOSE,
    CONTINUATION,
    PING,
    TEXT,
    Socket,
    Target,
    answered,
    head,
    message,
    upgrade,
)


def _origin(target: Target, source: random.Random) -> str:
    return source.choice(
        ("http://evil.example", "null", f"http://localhost.evil.example:{target.port}", f"http://{target.host}:1", "file://", "")
    )


def _path(source: random.Random) -> str:
    up = source.choice(("../", "..%2f", "%2e%2e/", "....//", "..\\", "/", "%00", "static/../../"))
    where = source.choice(("etc/passwd", "console.token", "core.py", "__main__.py", "index.html%00.js", "pyproject.toml"))
    return "/" + up * source.randint(1, 9) + where


def _nonsense(source: random.Random) -> str:
    """JSON that is none, or no request, or out of bounds."""
    return source.choice(
        (
            "",
            "{",
            "null",
            "[]" * 50,
            "[" * 2000,
            '{"type":"start","seed":-1}',
            '{"type":"start","layout":"/etc/passwd"}',
            '{"type":"start","steps":1e99}',
            '{"type":"start","period":"NaN"}',
            '{"type":"start","hider":"__import__"}',
            '{"type":"drive","primitive":"fly","held":true}',
            '{"type":"drive","primitive":"left"}',
            '{"type":"predict","goal":121}',
            '{"type":"predict","goal":1e400}',
            '{"type":"views","episode":1,"steps":[' + ",".join(["1"] * 65) + "]}",
            '{"type":"seek","position":-1}',
            '{"type":"control","action":"stop"}',
            '{"type":"publish","key":"episode"}',
            '{"type":"stop","stamp":1}',
            '{"type":["stop"]}',
            json.dumps({"type": "start", "person": "x" * 81}),
            "\0" * source.randint(1, 100),
            "".join(chr(source.randint(32, 0x2FF)) for _ in range(source.randint(1, 1000))),
        )
    )


def _wrong_origin_socket(target: Target, source: random.Random) -> str:
    with Socket(target, Origin=_origin(target, source)) as opened:
        return str(opened.status)


def _no_origin(target: Target, source: random.Random) -> str:
    with Socket(target, Origin=None) as opened:
        return str(opened.status)


def _wrong_host(target: Target, source: random.Random) -> str:
    host = source.choice(("evil.example", "evil.example:8600", "127.0.0.1.evil.example", "", "localhost.evil", "10.1.2.3"))
    if source.random() < 0.5:
        return answered(target, head("GET / HTTP/1.1", {"Host": host}))
    with Socket(target, Host=host, Origin=f"http://{host}") as opened:
        return str(opened.status)


def _wrong_origin_page(target: Target, source: random.Random) -> str:
    return answered(target, head("GET / HTTP/1.1", {"Host": target.name, "Origin": _origin(target, source)}))


def _other_method(target: Target, source: random.Random) -> str:
    method = source.choice(("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "CONNECT", "TRACE", "MADE-UP"))
    path = source.choice(("/", "/bus", "/control", "/index.html"))
    body = b'{"type":"stop"}' * source.randint(0, 3)
    return answered(target, head(f"{method} {path} HTTP/1.1", {"Host": target.name, "Content-Length": str(len(body))}) + body)


def _traversal(target: Target, source: random.Random) -> str:
    return answered(target, head(f"GET {_path(source)} HTTP/1.1", {"Host": target.name}))


def _no_http(target: Target, source: random.Random) -> str:
    return answered(target, source.randbytes(source.randint(1, 3000)) + b"\r\n\r\n")


def _huge_head(target: Target, source: random.Random) -> str:
    if source.random() < 0.5:
        return answered(target, f"GET /{'a' * source.randint(20_000, 200_000)} HTTP/1.1\r\nHost: {target.name}\r\n\r\n".encode())
    return answered(target, head("GET / HTTP/1.1", {"Host": target.name, **{f"X-{i}": "y" * 900 for i in range(60)}}))


def _two_hosts(target: Target, source: random.Random) -> str:
    return answered(target, f"GET / HTTP/1.1\r\nHost: {target.name}\r\nHost: evil.example\r\n\r\n".encode())


def _smuggled(target: Target, source: random.Random) -> str:
    lines = f"POST / HTTP/1.1\r\nHost: {target.name}\r\nContent-Length: 4\r\nTransfer-Encoding: chunked\r\n\r\n"
    return answered(target, lines.encode() + b"0\r\n\r\nGET /bus HTTP/1.1\r\n\r\n")


def _nonsense_text(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        opened.say(_nonsense(source))
        return opened.outcome()


def _out_of_place(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        opened.say(
            source.choice(
                (
                    '{"type":"seek","position":3}',
                    '{"type":"resume"}',
                    '{"type":"discard","episode":99999}',
                    '{"type":"start","hider":"human","period":0}',
                )
            )
        )
        return opened.outcome()


def _binary(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        opened.raw.sendall(message(BINARY, source.randbytes(source.randint(0, 4000))))
        return opened.outcome()


def _huge_message(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        with contextlib.suppress(ConnectionError):
            opened.raw.sendall(message(source.choice((TEXT, BINARY)), b" " * source.choice((4097, 20_000, 60_000, 3_000_000))))
        return opened.outcome()


def _claimed_huge(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        opened.raw.sendall(bytes([0x81, 0xFF]) + struct.pack(">Q", source.choice((2**31, 2**62))) + bytes(4) + b"{")
        return opened.outcome()


def _endless_fragments(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        with contextlib.suppress(ConnectionError):
            opened.raw.sendall(message(TEXT, b"{", final=False) + message(CONTINUATION, b"", final=False) * 200)
        return opened.outcome()


def _broken_frames(target: Target, source: random.Random) -> str:
    broken = source.choice(
        (
            message(TEXT, b"{}", masked=False),
            message(TEXT, b"{}", reserved=4),
            message(11, b""),
            message(PING, b"x" * 126),
            message(CONTINUATION, b"{}"),
            message(CLOSE, b"\x00"),
            message(TEXT, b"\xff\xfe\xfd"),
        )
    )
    with Socket(target) as opened:
        opened.raw.sendall(broken)
        return opened.outcome()


def _flood(target: Target, source: random.Random) -> str:
    """A key pressed 300 times at once, in no game of a human: no more than a connection it is."""
    with Socket(target) as opened:
        with contextlib.suppress(ConnectionError):
            opened.raw.sendall(message(TEXT, b'{"type":"drive","primitive":"left","held":true}') * 300)
        return opened.outcome()


def _ping_flood(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        with contextlib.suppress(ConnectionError):
            opened.raw.sendall(message(PING, b"p" * 100) * 2000)
        return opened.outcome()


def _half_open(target: Target, source: random.Random) -> str:
    """A handshake that is not finished; the connection is left for the console to close."""
    connection = target.connect()
    whole = upgrade(target)
    connection.sendall(whole[: source.randint(0, len(whole) - 2)])
    target.held.append(connection)
    if len(target.held) > 200:
        target.held.pop(0).close()
    return "left open"


def no_token(target: Target, source: random.Random) -> str:
    """No token, or a wrong one, where the console wants one: it is bound elsewhere than on loopback."""
    token = target.token
    assert token
    wrong = source.choice((None, "vantage", "vantage, " + "x" * 32, f"vantage, {token[:-1]}", f"{token.swapcase()}, vantage"))
    with Socket(target, Sec_WebSocket_Protocol=wrong) as opened:
        return str(opened.status)


Attack = Callable[[Target, random.Random], str]

ATTACKS: dict[str, tuple[Attack, frozenset[str]]] = {
    "WebSocket of another origin": (_wrong_origin_socket, frozenset({"403", "400"})),
    "WebSocket without origin": (_no_origin, frozenset({"403"})),
    "WebSocket without the token": (no_token, frozenset({"403"})),
    "another host": (_wrong_host, frozenset({"403", "400"})),
    "page asked by another origin": (_wrong_origin_page, frozenset({"403"})),
    "another method": (_other_method, frozenset({"405", "400"})),
    "path out of the folder": (_traversal, frozenset({"404", "400"})),
    "no HTTP": (_no_http, frozenset({"400", "cut off"})),
    "huge head": (_huge_head, frozenset({"400", "cut off"})),
    "two hosts": (_two_hosts, frozenset({"400", "403"})),
    "smuggled request": (_smuggled, frozenset({"400", "405"})),
    "no request": (_nonsense_text, frozenset({"notice", "closed 1009"})),
    "request out of place": (_out_of_place, frozenset({"notice"})),
    "binary message": (_binary, frozenset({"closed 1003"})),
    "huge message": (_huge_message, frozenset({"closed 1009", "cut off"})),
    "message said to be huge": (_claimed_huge, frozenset({"closed 1009", "cut off"})),
    "endless fragments": (_endless_fragments, frozenset({"cut off"})),
    "broken frames": (_broken_frames, frozenset({"closed 1002", "closed 1007", "cut off"})),
    "300 requests at once": (_flood, frozenset({"closed 1008", "cut off"})),
    "2000 pings": (_ping_flood, frozenset({"cut off"})),
    "half-open": (_half_open, frozenset({"left open"})),
}
"""What is tried, and how the console may answer: anything else was not refused."""


def attack(
    target: Target, requests: int, seed: int, pause: Callable[[], None] = lambda: None
) -> tuple[Counter[tuple[str, str]], list[str]]:
    """Send hostile requests of all kinds by turns.

    Returns:
        (kind, outcome) -> how often; and what was not refused.
    """
    source = random.Random(seed)
    outcomes: Counter[tuple[str, str]] = Counter()
    not_refused: list[str] = []
    kinds = list(ATTACKS.items())
    for number in range(requests):
        kind, (make, allowed) = kinds[number % len(kinds)]
        try:
            outcome = make(target, source)
        except TimeoutError:
            outcome = "no answer"
        except ConnectionError:
            outcome = "cut off"
            allowed = allowed | {"cut off"}
        outcomes[kind, outcome] += 1
        if outcome not in allowed:
            not_refused.append(f"{kind}: {outcome}")
        pause()
    return outcomes, not_refused
