"""The console as a pure core: what the bus says goes to the pages, what pages ask for goes, within bounds, to the bus."""

from __future__ import annotations

from collections.abc import Sequence

from schemas import Message
from services.console.declaration import DECLARATION
from services.console.events import PAGE, PageEvent
from services.console.frames import ALL, addressed, frame, frame_of
from vantage.service import Arrived, Captured, Received, Send, Write


class ConsoleCore:
    declaration = DECLARATION

    def __init__(self) -> None:
        self._latest: dict[str, Message] = {}
        self._clients: set[int] = set()
        self.trouble = ""

    def wake_at(self) -> int | None:
        return None

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Arrived):
            self._latest[received.key] = received.message
            if self._clients and (data := frame_of(received.key, received.message)) is not None:
                return [Write(PAGE, addressed(ALL, data))]
        elif isinstance(received, Captured) and isinstance(received.value, PageEvent):
            event = received.value
            if event.here and event.request is None:
                self._clients.add(event.client)
                frames = [frame("welcome", {"client": event.client})]
                frames += [data for key, message in self._latest.items() if (data := frame_of(key, message)) is not None]
                return [Write(PAGE, addressed(event.client, data)) for data in frames]
            if not event.here:
                self._clients.discard(event.client)
        return ()
