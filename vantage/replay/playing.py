"""A replay under way: the messages that are due go to the bus, wishes from the bus and the keyboard to the playback."""

from __future__ import annotations

from collections.abc import Callable

from msgspec.structs import replace

from schemas import Control, Health, MalformedMessage, Message
from schemas import Playback as PlaybackMessage
from vantage.bus import Sample
from vantage.replay.display import Display
from vantage.replay.playback import SECOND, SILENCE, Playback, Said

REPORT_PERIOD = SECOND // 2
DISPLAY_PERIOD = SECOND // 10
SKIP = 5.0
"""Seconds that an arrow key goes."""
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 100.0)
"""Speeds that the arrow keys go through."""


class Quit(Exception):
    """Somebody wishes the replay to end."""


def obey(playback: Playback, wish: object, now: int) -> list[Said]:
    """Do what a key (its meaning), or a message from `control`, asks for; return what is to be said for it.

    Raises:
        Quit: the key to quit.
        ValueError: it makes no sense in a replay; the text is for people.
    """
    match wish:
        case Control(action="pause") | "pause" if playback.state == "playing":
            return playback.pause(now)
        case Control(action="pause"):
            return playback.pause(now)
        case Control(action="resume"):
            return playback.resume(now, wish.speed)
        case "pause":
            return playback.resume(now)
        case Control(action="seek"):
            playback.seek(wish.position, now)
        case Control():
            raise ValueError(f"`{wish.action}` was asked for: nobody plays games in a replay")
        case "back" | "forward":
            playback.seek_by(SKIP if wish == "forward" else -SKIP, now)
        case "faster":
            playback.set_speed(min((speed for speed in SPEEDS if speed > playback.speed), default=SPEEDS[-1]), now)
        case "slower":
            playback.set_speed(max((speed for speed in SPEEDS if speed < playback.speed), default=SPEEDS[0]), now)
        case "next" | "previous":
            reached = playback.game(now)
            playback.seek_game((-1 if reached is None else reached) + (1 if wish == "next" else -1), now)
        case "quit":
            raise Quit
    return []


class Player:
    """Moves messages between a playback, the bus and the display, until it is told to quit.

    Args:
        playback: what is due.
        say: publishes a message of the log.
        publish: publishes as the replay.
        receive: waits at most so many seconds for the next event: of the bus, or the meaning of a key.
        clock: ns.
        games: how many the log has.
        once: end at the end of the log.
    """

    def __init__(
        self,
        playback: Playback,
        say: Callable[[Said], None],
        publish: Callable[[str, Message], None],
        receive: Callable[[float], object],
        clock: Callable[[], int],
        display: Display,
        games: int,
        once: bool,
    ) -> None:
        self._playback, self._display, self._games, self._once = playback, display, games, once
        self._say, self._publish, self._receive, self._clock = say, publish, receive, clock
        self._reported: PlaybackMessage | None = None
        self._report_at = 0
        self._show_at = 0
        self._stopping = False
        self._health: dict[str, tuple[Said, int]] = {}  # key -> last word, real time of saying it
        self._jumps = playback.jumps

    def stop(self) -> None:
        """End at the next turn; may be called from a signal handler."""
        self._stopping = True

    def run(self) -> None:
        """Play until the end of the log (`once`), or until somebody quits."""
        self.report()
        try:
            while not self._stopping and not (self._once and self._playback.state == "ended"):
                self.turn()
        except Quit:
            pass

    def turn(self) -> None:
        """Say what is due, tell how it stands, and take in one event."""
        now = self._clock()
        for said in self._playback.turn(now):
            self._say(said)
            if isinstance(said.message, Health):
                self._health[said.key] = said, now
        self._report_if_due(now)
        wakes = [self._report_at, self._show_at, self._playback.wake_at(now)]
        wait = (min(wake for wake in wakes if wake is not None) - self._clock()) / SECOND
        event = self._receive(max(0.0, wait))
        if event is None:
            return
        now = self._clock()
        try:
            # First the news of a jump, then what follows from it.
            sends = obey(self._playback, _wish_of(event), now)
        except ValueError as error:
            self._display.say(str(error))
            return
        self._report_if_due(now)
        for said in sends:
            self._say(said)

    def finish(self) -> None:
        """Tell that the replay is over, and that a game it stands in does."""
        for said in self._playback.pause(self._clock()):
            self._say(said)
        self._publish("playback", _ended(self._playback.report(self._clock())))

    def report(self) -> None:
        """Tell how it stands now."""
        now = self._clock()
        self._reported = self._playback.report(now)
        self._publish("playback", self._reported)
        self._report_at = now + REPORT_PERIOD
        self._repeat_health(now)

    def _repeat_health(self, now: int) -> None:
        """While the log's clock stands or creeps, let its services say every second what they said last, as live ones would.

        Who had fallen silent when the log was recorded stays silent.
        """
        if self._jumps != self._playback.jumps:
            self._jumps = self._playback.jumps
            self._health.clear()
        position = self._playback.position(now)
        for key, (said, told_at) in self._health.items():
            if now - told_at >= SECOND and position - said.log_time < SILENCE:
                self._say(said)
                self._health[key] = said, now

    def _report_if_due(self, now: int) -> None:
        playback, told = self._playback, self._reported
        changed = told is None or (told.state, told.speed, told.jumps) != (playback.state, playback.speed, playback.jumps)
        if changed or now >= self._report_at:
            self.report()
        if changed or now >= self._show_at:
            self._show_at = now + DISPLAY_PERIOD
            self._display.show(self._playback.report(now), self._playback.game(now), self._games)


def _ended(report: PlaybackMessage) -> PlaybackMessage:
    return replace(report, state="ended")


def _wish_of(event: object) -> object:
    if not isinstance(event, Sample):
        return event
    try:
        return event.decode()
    except MalformedMessage:
        return None
