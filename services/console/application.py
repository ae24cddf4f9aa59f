"""The web application: the page's files by GET, and one WebSocket, `/bus`. Everything else is refused, and counted."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from pathlib import Path

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from services.console.events import PageEvent
from services.console.frames import notice
from services.console.guard import PROTOCOL, SECURITY_HEADERS, Guard
from services.console.outbox import Outbox
from services.console.protocols import READY, Count
from services.console.rate import Rate
from services.console.requests import MESSAGE_LIMIT, MalformedRequest, decode_request

FOLDER = Path(__file__).resolve().parent / "page"
PAGES_LIMIT = 32
REQUESTS_A_SECOND, BURST = 40.0, 80.0
"""Of one page."""

TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".ico": "image/x-icon",
    ".woff2": "font/woff2",
}
"""Endings of the files that are served."""

ASKED_TOO_MUCH, ASKED_BADLY, FULL = 1008, 1003, 1013
"""Codes with which a WebSocket is closed."""


def files(folder: Path) -> dict[str, Path]:
    """Return what is served: path in the address -> file. A path that is not among these leads nowhere."""
    found = {
        f"/{path.relative_to(folder).as_posix()}": path
        for path in folder.rglob("*")
        if path.suffix in TYPES and path.is_file() and not path.is_symlink()
    }
    if "/index.html" in found:
        found["/"] = found["/index.html"]
    return found


class Page:
    """One browser's WebSocket, in the event loop's thread."""

    def __init__(self, client: int) -> None:
        self.client = client
        self.welcomed = False
        self._outbox = Outbox()
        self._waiting = asyncio.Event()

    def put(self, key: str, frame: bytes, forget: bool) -> None:
        self._outbox.put(key, frame, forget)
        self._waiting.set()

    async def send_all(self, socket: WebSocket) -> None:
        """Send what is put, for ever."""
        ready = socket.scope["extensions"][READY]
        while True:
            await ready()
            frame = self._outbox.take()
            if frame is None:
                self._waiting.clear()
                await self._waiting.wait()
            else:
                await socket.send({"type": "websocket.send", "bytes": frame})


class Application:
    """The pages that are there, and the ASGI application that they talk to.

    Args:
        tell: is told what pages do.
        count: is told why something was refused.
    """

    def __init__(self, guard: Guard, tell: Callable[[PageEvent], None], count: Count, folder: Path = FOLDER) -> None:
        self._guard, self._tell, self._count, self._files = guard, tell, count, files(folder)
        self._numbers = itertools.count(1)
        self.pages: dict[int, Page] = {}
        self.asgi: ASGIApp = _Door(
            Starlette(
                routes=[
                    WebSocketRoute("/bus", self._bus),
                    Route("/{path:path}", self._file, methods=["GET"]),
                ]
            ),
            guard,
            count,
        )

    async def _file(self, request: Request) -> Response:
        path = self._files.get(request.url.path)
        if path is None:
            self._count("no such file")
            return Response("There is no such file.\n", 404, media_type="text/plain")
        return Response(await asyncio.to_thread(path.read_bytes), headers={"content-type": TYPES[path.suffix]})

    async def _bus(self, socket: WebSocket) -> None:
        offered = list(socket.scope["subprotocols"])
        if not self._guard.admits(offered):
            self._count("no token" if offered in ([], [PROTOCOL]) else "wrong token")
            await socket.close()
            return
        if len(self.pages) >= PAGES_LIMIT:
            self._count("too many pages")
            await socket.accept(PROTOCOL if PROTOCOL in offered else None)
            await socket.close(FULL, f"{PAGES_LIMIT} pages are open: close one")
            return
        page = Page(next(self._numbers))
        self.pages[page.client] = page
        try:
            await socket.accept(PROTOCOL if PROTOCOL in offered else None)
            self._tell(PageEvent(page.client))
            sending = asyncio.ensure_future(page.send_all(socket))
            try:
                await self._listen(socket, page)
            finally:
                sending.cancel()
                await asyncio.gather(sending, return_exceptions=True)
        except WebSocketDisconnect:
            pass
        finally:
            del self.pages[page.client]
            self._tell(PageEvent(page.client, here=False))

    async def _listen(self, socket: WebSocket, page: Page) -> None:
        loop = asyncio.get_running_loop()
        rate = Rate(REQUESTS_A_SECOND, BURST)
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text")
            if text is None:
                self._count("binary message")
                await socket.close(ASKED_BADLY, "requests are JSON text")
                return
            if not rate.take(loop.time()):
                self._count("too fast")
                await socket.close(ASKED_TOO_MUCH, f"at most {REQUESTS_A_SECOND:g} requests a second")
                return
            try:
                request = decode_request(text)
            except MalformedRequest as error:
                self._count("malformed request")
                page.put("notice", notice(f"that was not understood: {error}"), forget=False)
                continue
            self._tell(PageEvent(page.client, request))


class _Door:
    """In front of the application: refuses what does not come from this server's own page, and adds the security headers."""

    def __init__(self, inner: ASGIApp, guard: Guard, count: Count) -> None:
        self._inner, self._guard, self._count = inner, guard, count

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers: dict[bytes, list[str]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name.lower(), []).append(value.decode("latin-1"))
        upgrade = scope["type"] == "websocket"
        reason = self._guard.refusal(headers.get(b"host", []), headers.get(b"origin", []), upgrade)
        if reason:
            self._count(reason)
            if upgrade:
                await receive()
                await send({"type": "websocket.close", "code": ASKED_TOO_MUCH})
            else:
                await Response(f"Refused: {reason}.\n", 403, _names(SECURITY_HEADERS))(scope, receive, send)
            return
        if not upgrade and scope["method"] not in ("GET", "HEAD"):
            self._count("wrong method")
            refusal = Response("Only GET.\n", 405, {"allow": "GET, HEAD", "connection": "close", **_names(SECURITY_HEADERS)})
            await refusal(scope, receive, send)
            return

        async def with_headers(message: object) -> None:
            assert isinstance(message, dict)
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", []), *SECURITY_HEADERS]}
            await send(message)

        await self._inner(scope, receive, send if upgrade else with_headers)


def _names(headers: tuple[tuple[bytes, bytes], ...]) -> dict[str, str]:
    return {name.decode(): value.decode() for name, value in headers}


__all__ = ["FOLDER", "MESSAGE_LIMIT", "PAGES_LIMIT", "Application", "Page", "files"]
