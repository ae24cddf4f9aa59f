"""The sessions of a replay on the bus."""

from __future__ import annotations

import time
from collections.abc import Collection
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from schemas import Message
from vantage.bus import Alive, Bus, NameInUse
from vantage.bus.zenoh_bus import ZenohBus
from vantage.replay.cast import REPLAY, Cast, cast
from vantage.replay.playback import Said
from vantage.replay.trouble import ReplayError

REFEREE = "referee"
MEETING = 2.0
"""Seconds that the sessions may take to see each other."""


class Sessions:
    """See the module. `bus` is the session `replay`, which hears wishes; the others only speak.

    The name of the referee is held even if the log has no referee, so that no live game starts in the middle of a replay.

    Attributes:
        cast: who says what, known once the sessions are open.
    """

    def __init__(
        self, publishers: Collection[tuple[str, str]], folder: Path, arena: str, alive: Collection[str], without: Collection[str]
    ) -> None:
        """Open them.

        Args:
            publishers: (key, publisher) pairs of the log.
            folder: of the deployment.
            arena: its name.
            alive: services of the deployment; others are found out by their names being taken.
            without: names to leave out.

        Raises:
            ReplayError: a live referee, or another replay, is on the bus.
            CannotOpen: the folder cannot be used.
        """
        self._folder, self._arena = folder, arena
        self._closing = ExitStack()
        self._buses: dict[str, Bus] = {}
        self._seen: set[str] = set()
        found = set(alive)
        try:
            # First this one: another replay holds the name of the referee, too.
            if not self._opened(REPLAY):
                raise ReplayError(f"another replay is playing in {folder}: quit it first, or replay elsewhere (--folder)")
            if REFEREE in found or not self._opened(REFEREE):
                raise ReplayError(
                    f"a referee is alive in {folder}, and a log must not be mixed into its games: stop it (`vantage down`), "
                    "or replay elsewhere (--folder)"
                )
            self.cast: Cast = cast(publishers, found, without)
            while taken := [name for name in self.cast.sessions() if not self._opened(name)]:
                found.update(taken)
                self.cast = cast(publishers, found, without)
            for name in set(self._buses) - {*self.cast.sessions(), REFEREE}:
                self._buses.pop(name).close()
            self.bus = self._buses[REPLAY]
            self.bus.subscribe("control")
            self.bus.watch()
            for bus in self._buses.values():
                bus.receive(0.0)  # who has received is seen to be there
            self._meet()
        except BaseException:
            self.close()
            raise

    def say(self, said: Said) -> None:
        """Publish a message of the log."""
        self._buses[self.cast.voices[said.key, said.publisher]].publish(said.key, said.message)

    def is_played(self, key: str, publisher: str) -> bool:
        """Whether somebody says what this publisher said on a key."""
        return (key, publisher) in self.cast.voices

    def publish(self, key: str, message: Message) -> None:
        """Publish as the replay."""
        self.bus.publish(key, message)

    def close(self) -> None:
        """Leave the bus."""
        self._closing.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _opened(self, name: str) -> bool:
        """Open a session, unless it is; return whether it could be, or whether the name is taken."""
        if name not in self._buses:
            try:
                self._buses[name] = self._closing.enter_context(ZenohBus(name, self._folder, self._arena))
            except NameInUse:
                return False
        return True

    def _meet(self) -> None:
        """Wait until everybody is seen: what is said then is heard."""
        deadline = time.monotonic() + MEETING
        while not self._seen.issuperset(self._buses) and (left := deadline - time.monotonic()) > 0:
            event = self.bus.receive(left)
            if isinstance(event, Alive) and event.alive:
                self._seen.add(event.name)
