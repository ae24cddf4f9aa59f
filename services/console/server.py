"""The web server as a device of the console: what pages ask for is read from it, frames for them are written to it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import queue
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import uvicorn

from services.console.application import FOLDER, Application
from services.console.events import PAGE, PageEvent, Refusals
from services.console.frames import ALL
from services.console.guard import Guard, token_of
from services.console.outbox import FORGET, OF_NO_GAME
from services.console.protocols import protocols
from services.console.requests import MESSAGE_LIMIT
from vantage.deployment import CONSOLE_ADDRESS
from vantage.service import DeviceLost, steady_clock

DEFAULT_PORT = 8600
NEXT_PORTS = 16
"""Ports tried where the default one is taken."""
TOLD_PERIOD = 1.0
"""Seconds between reports of what was refused."""
READ_PATIENCE = 0.1
START_PATIENCE = 5.0
STOP_PATIENCE = 0.8
CLOSING = 0.05
"""Seconds in which pages can still be told that the console ends."""
PING_PERIOD, PONG_PATIENCE = 1.0, 2.0
"""Seconds after which a page that answers no ping is gone: its held key would drive a robot on. Browsers answer by themselves."""


@dataclass(frozen=True)
class ServerSettings:
    """Where the page is."""

    host: str = "127.0.0.1"
    """Address to listen on. Pages need the token in the address that `vantage up` and `vantage status` print."""
    port: int = DEFAULT_PORT
    """Port to listen on; 0: any free one. Where the default is taken, the next free one."""


class _Header(msgspec.Struct):
    key: str
    forget: bool = False


_header = msgspec.json.Decoder(_Header)


class _Server(uvicorn.Server):
    """uvicorn's server, which ends at once: pages are told, but none can keep it."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        for server in self.servers:
            server.close()
        for connection in list(self.server_state.connections):
            connection.shutdown()
        await asyncio.sleep(CLOSING)
        for task in list(self.server_state.tasks):
            task.cancel()
        for connection in list(self.server_state.connections):
            connection.transport.abort()


class PageServer:
    """The device `page`. `write` takes a frame with the client's number in front (see `frames`), and never waits.

    Args:
        folder: of the deployment; holds `console.address` and `console.token`.
        page: folder of what is served.
    """

    name = PAGE
    newest_only = False

    def __init__(
        self,
        settings: ServerSettings,
        folder: Path,
        clock: Callable[[], int] = steady_clock,
        page: Path = FOLDER,
    ) -> None:
        self._settings, self._folder, self._clock, self._page = settings, folder, clock, page
        self._events: queue.SimpleQueue[PageEvent] = queue.SimpleQueue()
        self._refused: Counter[str] = Counter()
        self._told: dict[str, int] = {}
        self._told_at = 0.0
        self._lock = threading.Lock()
        self._unsent: dict[tuple[int, str], tuple[bytes, bool]] = {}
        self._woken = False
        self._application: Application | None = None
        self._server: uvicorn.Server | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._failure = ""
        self.port = 0
        """Where it listens; 0 while it does not."""
        self.token = ""

    @property
    def address(self) -> str:
        """The page's address, with the token."""
        host = self._settings.host
        if host in ("0.0.0.0", "::", ""):
            host = socket.gethostname()
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.port}/#token={self.token}"

    def open(self) -> None:
        """Listen. Raises DeviceLost when that is not possible."""
        try:
            self.token = token_of(self._folder)
        except OSError as error:
            raise DeviceLost(f"the token for the page cannot be kept: {error}") from error
        listening = self._listen()
        self.port = listening.getsockname()[1]
        self._application = Application(Guard(self._settings.host, self.token), self._events.put, self.count, self._page)
        http, websocket = protocols(self.count)
        server = _Server(
            uvicorn.Config(
                self._application.asgi,
                http=http,
                ws=websocket,
                loop="asyncio",
                lifespan="off",
                ws_max_size=MESSAGE_LIMIT,
                ws_ping_interval=PING_PERIOD,
                ws_ping_timeout=PONG_PATIENCE,
                ws_per_message_deflate=False,
                log_config=None,
                access_log=False,
                proxy_headers=False,
                server_header=False,
                date_header=False,
                h11_max_incomplete_event_size=16 * 1024,
                timeout_keep_alive=5,
            )
        )
        # One line for every stranger who says nonsense would fill the log; they are counted.
        logging.getLogger("uvicorn").setLevel(logging.ERROR)
        self._server, self._failure = server, ""
        self._thread = threading.Thread(target=self._run, args=(server, listening), name="page-server", daemon=True)
        self._thread.start()
        until = time.monotonic() + START_PATIENCE
        while not server.started:
            if not self._thread.is_alive() or time.monotonic() > until:
                raise DeviceLost(f"the web server did not start: {self._failure or 'it says nothing'}")
            time.sleep(0.005)
        try:
            self._write_address()
        except OSError as error:
            raise DeviceLost(f"the page's address cannot be kept: {error}") from error
        logging.getLogger("vantage").info("the page is at %s", self.address.partition("#")[0])

    def read(self) -> tuple[PageEvent | Refusals, int] | None:
        """Return what a page did next, or once a second what was refused; None when nothing comes in time."""
        now = time.monotonic()
        if now - self._told_at >= TOLD_PERIOD and self._told != self._refused:
            self._told_at = now
            with self._lock:
                self._told = dict(self._refused)
            return Refusals(self._told), self._clock()
        try:
            event = self._events.get(timeout=READ_PATIENCE)
        except queue.Empty:
            if self._thread is None or not self._thread.is_alive():
                raise DeviceLost(f"the web server has stopped: {self._failure or 'it says nothing'}") from None
            return None
        return event, self._clock()

    def write(self, data: bytes) -> None:
        """Send a frame to one page or, with client number 0, to all. What waits already of its key is replaced."""
        client = int.from_bytes(data[:4], "little")
        header = _header.decode(memoryview(data)[8 : 8 + int.from_bytes(data[4:8], "little")])
        with self._lock:
            loop = self._loop
            if loop is None:
                return
            if header.forget:
                for other in [place for place in self._unsent if client in (ALL, place[0]) and place[1] not in OF_NO_GAME]:
                    del self._unsent[other]
            place = client, FORGET if header.forget else header.key
            # To the end: a frame for one page and one for all pages must not overtake each other.
            self._unsent.pop(place, None)
            self._unsent[place] = data[4:], header.forget
            if self._woken:
                return
            self._woken = True
        with contextlib.suppress(RuntimeError):  # the loop is just closing
            loop.call_soon_threadsafe(self._hand_out)

    def close(self) -> None:
        """Stop serving; pages are told, and nobody is waited for."""
        server, thread = self._server, self._thread
        if server is None or thread is None:
            return
        server.should_exit = True
        thread.join(STOP_PATIENCE)
        self._server = self._thread = None
        self.port = 0

    def count(self, reason: str) -> None:
        """Note that somebody was refused."""
        with self._lock:
            self._refused[reason] += 1

    def _hand_out(self) -> None:
        with self._lock:
            unsent, self._unsent = self._unsent, {}
            self._woken = False
        assert self._application is not None
        pages = self._application.pages
        for (client, key), (data, forget) in unsent.items():
            if client == ALL:
                for page in pages.values():
                    if page.welcomed:
                        page.put(key, data, forget)
            elif (page_of := pages.get(client)) is not None:
                page_of.welcomed = page_of.welcomed or key == "welcome"
                page_of.put(key, data, forget)

    def _run(self, server: uvicorn.Server, listening: socket.socket) -> None:
        async def serve() -> None:
            loop = asyncio.get_running_loop()
            loop.set_exception_handler(lambda _loop, _context: self.count("broken connection"))
            with self._lock:
                self._loop = loop
            try:
                await server.serve(sockets=[listening])
            finally:
                with self._lock:
                    self._loop = None
                    self._unsent.clear()
                    self._woken = False

        try:
            asyncio.run(serve())
        except BaseException as error:  # told by `read`
            self._failure = f"{type(error).__name__}: {error}"
        finally:
            listening.close()

    def _listen(self) -> socket.socket:
        host, port = self._settings.host, self._settings.port
        ports = [port]
        if port == DEFAULT_PORT:
            ports = [port + offset for offset in range(NEXT_PORTS + 1)]
        if port in (0, DEFAULT_PORT) and (before := self._port_before()):
            # Pages that are open find the console again after a restart.
            ports = [before, *ports]
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        for tried in ports:
            listening = socket.socket(family, socket.SOCK_STREAM)
            try:
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listening.bind((host, tried))
                listening.listen(128)
                listening.setblocking(False)
                return listening
            except OSError as error:
                listening.close()
                if error.errno != errno.EADDRINUSE:
                    raise DeviceLost(f"cannot listen on {host} port {tried}: {error.strerror}") from error
        tried_ports = f"port {ports[-1]} is" if len(ports) == 1 else f"ports {min(ports)} to {max(ports)} are"
        raise DeviceLost(f"{tried_ports} taken on {host}: end the program there, or choose another with --port (0: any free one)")

    def _port_before(self) -> int:
        try:
            address = (self._folder / CONSOLE_ADDRESS).read_text().strip()
            return int(address.partition("#")[0].rstrip("/").rpartition(":")[2])
        except (OSError, ValueError):
            return 0

    def _write_address(self) -> None:
        path = self._folder / CONSOLE_ADDRESS
        fresh = path.with_name(f"{path.name}.{os.getpid()}")
        with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
            file.write(self.address + "\n")
        fresh.rename(path)
