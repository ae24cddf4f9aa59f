"""uvicorn's two protocols with limits of ours: connections, slow handshakes, floods, clients that never read."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from typing import Any, cast

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.exceptions import InvalidState

CONNECTIONS_LIMIT = 64
"""Connections in all, WebSockets among them; beyond it the oldest that is no WebSocket is closed."""
HANDSHAKE_PATIENCE = 5.0
"""Seconds in which a request's head and body must have come, and its answer been taken."""
SEND_BUFFER = 512 * 1024
"""Bytes that the kernel keeps for a page: what it has is shown late by a browser that was stopped."""
WINDOW = 128 * 1024
"""Bytes under way to a page, and one frame: what the kernels would take is shown seconds late by a browser that was stopped."""
MARK_EVERY = 64 * 1024
"""Bytes after which a page is pinged: its answer says that it has read so far."""
MARK = b"read"
READY = "vantage.ready"
"""Extension of the ASGI scope: awaited before a frame is chosen, so that what was chosen is not old when it can be sent."""
UNREAD_LIMIT = 8 * 1024 * 1024
"""Bytes that may wait for a client that does not read (answers to its pings)."""
BYTES_A_SECOND = 64 * 1024
"""What a page may send."""
REQUEST_LIMIT = 16 * 1024
"""Bytes of an HTTP request, head and body."""
FRAGMENTS_LIMIT = 16

Count = Callable[[str], None]


def protocols(count: Count) -> tuple[type[asyncio.Protocol], type[asyncio.Protocol]]:
    """Return the classes for HTTP and for WebSockets; `count` is told why somebody was cut off."""

    class Http(H11Protocol):
        _patience: asyncio.TimerHandle | None = None
        _received = 0

        def __init__(self, *arguments: Any, **named: Any) -> None:
            super().__init__(*arguments, **named)
            self.opened = self.loop.time()

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            taken = transport.get_extra_info("socket")
            if taken is not None:
                taken.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
                # asyncio does so only for sockets that were made with the protocol's number.
                taken.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if len(self.connections) > CONNECTIONS_LIMIT:
                self._make_room()
            self._patience = self.loop.call_later(HANDSHAKE_PATIENCE, self._lose_patience)

        def data_received(self, data: bytes) -> None:
            # h11 limits only a head that comes in pieces.
            self._received += len(data)
            if self._received > REQUEST_LIMIT:
                count("huge request")
                self.transport.abort()
                return
            super().data_received(data)

        def connection_lost(self, exc: Exception | None) -> None:
            self._calm()
            super().connection_lost(exc)

        def handle_websocket_upgrade(self, event: Any) -> None:
            self._calm()
            super().handle_websocket_upgrade(event)

        def on_response_complete(self) -> None:
            self._calm()
            self._received = 0
            super().on_response_complete()
            if not self.transport.is_closing():
                # The next request on this connection has its own time to come, beyond the pause that is allowed before it.
                self._patience = self.loop.call_later(self.timeout_keep_alive + HANDSHAKE_PATIENCE, self._lose_patience)

        def send_400_response(self, msg: str) -> None:
            count("not HTTP")
            super().send_400_response(msg)

        def _calm(self) -> None:
            if self._patience is not None:
                self._patience.cancel()
                self._patience = None

        def _lose_patience(self) -> None:
            count("too slow")
            self.transport.abort()

        def _make_room(self) -> None:
            others = [connection for connection in self.connections if isinstance(connection, Http)]
            oldest = min(others, key=lambda connection: connection.opened)
            count("too many connections")
            # abort tells connection_lost only in the loop's next turn: the place is free from now on.
            self.connections.discard(oldest)
            oldest.transport.abort()

    class WebSocket(WebSocketsSansIOProtocol):
        _budget = float(BYTES_A_SECOND)
        _budget_at = 0.0
        _sent = _marked = _read = 0

        def __init__(self, *arguments: Any, **named: Any) -> None:
            super().__init__(*arguments, **named)
            self._window = asyncio.Event()

        async def run_asgi(self) -> None:
            cast(Any, self.scope)["extensions"][READY] = self.ready
            await super().run_asgi()

        async def ready(self) -> None:
            """Wait until the page has read what was sent, all but a window, and nothing waits in this program's memory."""
            while self._sent - self._read > WINDOW and not self.disconnected:
                self._window.clear()
                await self._window.wait()
            await self.writable.wait()

        async def send(self, message: Any) -> None:
            await super().send(message)
            if message["type"] != "websocket.send":
                return
            self._sent += len(message["bytes"])
            if self._sent - self._marked >= MARK_EVERY and not self.close_sent:
                self._marked = self._sent
                with contextlib.suppress(InvalidState):  # it has just been closed
                    self.conn.send_ping(MARK + self._sent.to_bytes(8, "big"))
                    self.transport.write(b"".join(self.conn.data_to_send()))

        def handle_pong(self, event: Any) -> None:
            data = bytes(event.data)
            if not data.startswith(MARK):
                super().handle_pong(event)
                return
            read = int.from_bytes(data[len(MARK) :], "big")
            if self._read < read <= self._sent:
                self._read = read
                self._window.set()

        def connection_lost(self, exc: Exception | None) -> None:
            super().connection_lost(exc)
            self._window.set()

        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(transport)
            # What waits here, in the program's memory, cannot be replaced by something newer: nothing is to wait.
            cast(asyncio.Transport, transport).set_write_buffer_limits(high=0)
            self._budget_at = self.loop.time()

        def data_received(self, data: bytes) -> None:
            now = self.loop.time()
            self._budget = min(float(BYTES_A_SECOND), self._budget + (now - self._budget_at) * BYTES_A_SECOND) - len(data)
            self._budget_at = now
            if self._budget < 0:
                self._cut_off("too fast")
                return
            super().data_received(data)
            if self.transport.get_write_buffer_size() > UNREAD_LIMIT:
                self._cut_off("never reads")

        def handle_cont(self, event: Any) -> None:
            if len(self.frames) >= FRAGMENTS_LIMIT:
                self._cut_off("too many fragments")
                return
            super().handle_cont(event)

        def send_receive_event_to_app(self) -> None:
            if self.curr_msg_data_type == "text":
                try:
                    b"".join(self.frames).decode()
                except UnicodeDecodeError:
                    self._cut_off("not UTF-8")
                    return
            super().send_receive_event_to_app()

        def handle_parser_exception(self) -> None:
            count("huge message" if self.conn.close_sent is not None and self.conn.close_sent.code == 1009 else "not WebSocket")
            super().handle_parser_exception()

        def keepalive_timeout(self) -> None:
            count("gone silent")
            super().keepalive_timeout()
            if self.transport.get_write_buffer_size():
                # `close` would wait until the page has taken all of it, and the page would still be at the wheel.
                self.transport.abort()

        def _cut_off(self, reason: str) -> None:
            if not self.transport.is_closing():
                count(reason)
            self.transport.abort()

    return Http, WebSocket
