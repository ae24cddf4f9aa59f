"""A WebSocket and HTTP by hand, so that everything can be wrong with them."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from urllib.parse import urlsplit

PATIENCE = 5.0
TEXT, BINARY, CLOSE, PING, PONG, CONTINUATION = 1, 2, 8, 9, 10, 0


@dataclass
class Target:
    """Where the console is, and connections that are left open on purpose."""

    host: str
    port: int
    token: str
    held: list[socket.socket] = field(default_factory=list)

    @classmethod
    def at(cls, address: str) -> Target:
        """Return the target of the address that a console has printed."""
        parts = urlsplit(address)
        assert parts.hostname is not None and parts.port is not None
        return cls(parts.hostname, parts.port, parts.fragment.removeprefix("token="))

    @property
    def name(self) -> str:
        return f"{self.host}:{self.port}"

    def connect(self) -> socket.socket:
        connection = socket.create_connection((self.host, self.port), timeout=PATIENCE)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection


def head(line: str, headers: dict[str, str]) -> bytes:
    return "\r\n".join([line, *(f"{name}: {value}" for name, value in headers.items()), "", ""]).encode("latin-1")


def upgrade(target: Target, **changed: str | None) -> bytes:
    """The head of a WebSocket's handshake as the real page's browser sends it, with headers changed or left out."""
    headers: dict[str, str | None] = {
        "Host": target.name,
        "Origin": f"http://{target.name}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": base64.b64encode(os.urandom(16)).decode(),
        "Sec-WebSocket-Protocol": f"vantage, {target.token}",
        **{name.replace("_", "-"): value for name, value in changed.items()},
    }
    return head("GET /bus HTTP/1.1", {name: value for name, value in headers.items() if value is not None})


def message(opcode: int, data: bytes, final: bool = True, masked: bool = True, reserved: int = 0) -> bytes:
    """A WebSocket frame as a client sends it."""
    first = (0x80 if final else 0) | reserved << 4 | opcode
    size = len(data)
    length = (
        bytes([size]) if size < 126 else b"\x7e" + struct.pack(">H", size) if size < 65536 else b"\x7f" + struct.pack(">Q", size)
    )
    if not masked:
        return bytes([first]) + length + data
    return bytes([first, length[0] | 0x80]) + length[1:] + bytes(4) + data


class Socket:
    """A WebSocket by hand, so that everything can be wrong with it."""

    def __init__(self, target: Target, **changed: str | None) -> None:
        self.raw = target.connect()
        self.raw.sendall(upgrade(target, **changed))
        self._buffer = b""
        while b"\r\n\r\n" not in self._buffer:
            if not (got := self.raw.recv(65536)):
                break
            self._buffer += got
        top, _, self._buffer = self._buffer.partition(b"\r\n\r\n")
        self.status = int(top.split()[1]) if top else 0

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *_: object) -> None:
        self.raw.close()

    def say(self, text: str) -> None:
        self.raw.sendall(message(TEXT, text.encode()))

    def receive(self) -> tuple[int, bytes]:
        """Opcode and data of the next frame but for pings, which are answered; (CLOSE, b"") where the connection is cut."""
        while True:
            opcode, data = self._receive()
            if opcode != PING:
                return opcode, data
            with contextlib.suppress(ConnectionError):
                self.raw.sendall(message(PONG, data))

    def _receive(self) -> tuple[int, bytes]:
        try:
            start = self._exactly(2)
            size = start[1] & 0x7F
            if size == 126:
                (size,) = struct.unpack(">H", self._exactly(2))
            elif size == 127:
                (size,) = struct.unpack(">Q", self._exactly(8))
            return start[0] & 0x0F, self._exactly(size)
        except (ConnectionError, EOFError):
            return CLOSE, b""

    def _exactly(self, count: int) -> bytes:
        while len(self._buffer) < count:
            got = self.raw.recv(1 << 20)
            if not got:
                raise EOFError
            self._buffer += got
        data, self._buffer = self._buffer[:count], self._buffer[count:]
        return data

    def headers(self) -> Iterator[dict[str, object]]:
        """Headers of the console's frames as they come, until it closes."""
        while True:
            opcode, data = self.receive()
            if opcode == CLOSE:
                code = struct.unpack(">H", data[:2])[0] if len(data) >= 2 else 0
                yield {"key": f"closed {code}" if code else "cut off"}
                return
            if opcode == BINARY:
                yield json.loads(data[4 : 4 + int.from_bytes(data[:4], "little")])

    def outcome(self) -> str:
        """What came of it: `notice`, `closed CODE` or `cut off`."""
        return next(str(header["key"]) for header in self.headers() if str(header["key"]).startswith(("notice", "closed", "cut")))


def answered(target: Target, request: bytes) -> str:
    """Send bytes; return the status of the answer, or `cut off`."""
    with target.connect() as connection:
        with contextlib.suppress(ConnectionError):
            connection.sendall(request)
        try:
            first = connection.recv(4096)
        except ConnectionError:
            first = b""
    return first.split()[1].decode() if first.startswith(b"HTTP/") else "cut off"
