"""The page server as tests use it: read all the time, with a small page of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from services.console import requests
from services.console.events import PageEvent, Refusals
from services.console.frames import addressed, frame
from services.console.server import PageServer, ServerSettings
from tests.services.console_game import parse
from tests.services.console_socket import BINARY, Socket, Target, head

PATIENCE = 120.0
"""Seconds until a wait fails: no test is to depend on how fast the machine is."""


class Console:
    """A page server that is read all the time, as the runtime does, and welcomes every page."""

    def __init__(self, folder: Path, host: str = "127.0.0.1", port: int = 0) -> None:
        self.page = folder / "page"
        if not self.page.exists():
            (self.page / "parts").mkdir(parents=True)
            (self.page / "index.html").write_text("<!doctype html><title>Vantage</title>")
            (self.page / "parts" / "draw.js").write_text("export const x = 1;")
            (self.page / "notes.txt").write_text("not served")
            (folder / "secret.js").write_text("secret")
            (self.page / "link.js").symlink_to(folder / "secret.js")
        self.server = PageServer(ServerSettings(host=host, port=port), folder, page=self.page)
        self.server.open()
        self.target = Target(host if host != "0.0.0.0" else "127.0.0.1", self.server.port, self.server.token)
        self.events: list[PageEvent] = []
        self.refused: dict[str, int] = {}
        self._stop = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._stop:
            got = self.server.read()
            if got is None:
                continue
            value, _ = got
            if isinstance(value, Refusals):
                self.refused = value.counts
                continue
            self.events.append(value)
            if value.request is None and value.here:
                self.server.write(addressed(value.client, frame("welcome", {"client": value.client})))

    @property
    def asked(self) -> list[requests.AnyRequest]:
        return [event.request for event in self.events if event.request is not None]

    def wait(self, until: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not until():
            assert time.monotonic() < end, "what was waited for has not come"
            time.sleep(0.005)

    def count(self, reason: str) -> int:
        return self.server._refused[reason]

    def show(self, key: str, payload: bytes = b"", client: int = 0, **fields: object) -> None:
        self.server.write(addressed(client, frame(key, fields, payload)))

    def open_page(self, **changed: str | None) -> Socket:
        opened = Socket(self.target, **changed)
        assert opened.status == 101
        opcode, data = opened.receive()
        assert (opcode, parse(data)[0]["key"]) == (BINARY, "welcome")
        return opened

    def close(self) -> None:
        self._stop = True
        self._thread.join(2.0)
        self.server.close()


def get(target: Target, path: str, **more: str) -> tuple[int, dict[str, str], bytes]:
    with target.connect() as connection:
        connection.sendall(head(f"GET {path} HTTP/1.1", {"Host": target.name, "Connection": "close", **more}))
        data = b""
        while got := connection.recv(65536):
            data += got
    top, _, body = data.partition(b"\r\n\r\n")
    lines = top.decode().split("\r\n")
    return (
        int(lines[0].split()[1]),
        {name.lower(): value for name, _, value in (line.partition(": ") for line in lines[1:])},
        body,
    )
