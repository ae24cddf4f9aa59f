"""`vantage replay`: play a recorded log on the bus."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn

from schemas import FASTEST, SERVICES, SLOWEST
from vantage.bus import Alive
from vantage.log.games import NoSuchGame, find_game
from vantage.printable import counted
from vantage.replay.display import Display, clock_text
from vantage.replay.hosting import hosted
from vantage.replay.keys import keyboard
from vantage.replay.playback import SECOND, Playback
from vantage.replay.playing import Player
from vantage.replay.recording import Recording, find_parts
from vantage.replay.sessions import REFEREE, Sessions
from vantage.replay.trouble import ReplayError
from vantage.service import steady_clock

console = Console(highlight=False)

Run = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]


@dataclass(frozen=True)
class Settings:
    """Play a recorded log on the bus with the log's clock, so that console and services work on it as if it were live.

    Every recorded service speaks by a session of its own name; whoever is alive takes its own part instead, and is named. Where
    nothing is up in the folder, predictor and console are started, and stopped at the end. Wishes of the recorded day
    (`control`) are not played. It obeys pause, resume and seek of the console's page, and the keys: space pause, left and right
    5 s, up and down speed, n and p next and previous game, q quit.

    Examples:
        vantage replay logs/table-20261122-141530.mcap
        vantage replay demo/ --game 1 --speed 2
        vantage replay logs/run_000.mcap --from 90 --paused
        vantage replay logs/run_000.mcap --without planner --once
    """

    run: Run
    """The log: a file, the first part of several (NAME_000.mcap), or a folder with one log."""
    speed: float = 1.0
    """Times as fast as it was recorded, 0.1 to 100. Near 0.1 steps are 2.5 s apart: live services may call their inputs stale."""
    from_: Annotated[float | None, tyro.conf.arg(name="from")] = None
    """Begin so many seconds after the log's first message."""
    game: int | None = None
    """Begin with the game of this number, see `vantage log info`."""
    loop: bool = False
    """At the end, begin again; else it stays at the end, ready to seek."""
    paused: bool = False
    """Wait at the start, until space or `resume`."""
    once: bool = False
    """End at the end of the log (for scripts)."""
    without: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ()
    """Recorded services to leave out, for live ones that you start meanwhile. Not the referee: its games are the log's."""
    folder: Path | None = None
    """Private runtime folder of the deployment; default /tmp/vantage-USERID/replay."""
    arena: str = "table"
    """Name of the arena on the bus."""
    start: bool = True
    """Start predictor and console (compose/replay.conf) if nothing is up in the folder."""
    timeout: float = 60.0
    """Seconds that these may take to be healthy."""


def main(settings: Settings) -> int:
    """Replay; 0 unless something was wrong with the log, then 2."""
    _check(settings)
    with ExitStack() as closing:
        recording = _open(settings.run)
        closing.callback(recording.close)
        position = _beginning(settings, recording)
        stopping = closing.enter_context(_stop_on_signals())
        hosting = hosted(settings.folder, settings.arena, settings.start, settings.timeout, console)
        deployment, services = closing.enter_context(hosting)
        sessions = closing.enter_context(
            Sessions(recording.publishers, deployment.folder, settings.arena, services, settings.without)
        )
        _tell(recording, sessions, deployment.console_address())
        _play(settings, recording, sessions, position, stopping)
    for text in recording.breaks:
        console.print(f"[yellow]{escape(text)}[/]", soft_wrap=True)
    return 2 if recording.breaks else 0


def _play(settings: Settings, recording: Recording, sessions: Sessions, position: int | None, stopping: _Stopping) -> None:
    bus = sessions.bus
    playback = Playback(
        recording,
        sessions.is_played,
        steady_clock(),
        speed=settings.speed,
        paused=settings.paused,
        loop=settings.loop,
        position=position,
    )

    def receive(timeout: float) -> object:
        event = bus.receive(timeout)
        if isinstance(event, Alive) and event.name in sessions.cast.replaced:
            display.say(f"{event.name} is {'there' if event.alive else 'gone'}")
        return event

    with keyboard(bus.post) as keys, Display(console, keys) as display:
        games = len(recording.games)
        player = Player(playback, sessions.say, sessions.publish, receive, steady_clock, display, games, settings.once)
        stopping.hand_over(player.stop, bus.wake)
        try:
            player.run()
        finally:
            player.finish()
    for why, count in playback.skipped.items():
        console.print(f"{count} messages were not played: {why}")


def _open(run: Path) -> Recording:
    parts = find_parts(run)
    columns = (TextColumn("looking through {task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %"))
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task(escape(parts[0].name), total=1.0)
        return Recording(*parts, progress=lambda part: progress.update(bar, completed=part))


def _beginning(settings: Settings, recording: Recording) -> int | None:
    """Return the log time to begin at; None = before the first message."""
    if settings.game is not None:
        try:
            return find_game(recording.games, settings.game).start
        except NoSuchGame as error:
            raise ReplayError(f"{recording.name}: {error}") from None
    if settings.from_ is None:
        return None
    duration = (recording.end - recording.start) / SECOND
    if not 0.0 <= settings.from_ <= duration:
        raise ReplayError(f"--from {settings.from_:g}: the log is {duration:.1f} s long")
    return recording.start + round(settings.from_ * SECOND)


def _check(settings: Settings) -> None:
    if not SLOWEST <= settings.speed <= FASTEST:
        raise ReplayError(f"--speed must be {SLOWEST:g} to {FASTEST:g}, not {settings.speed:g}")
    if settings.from_ is not None and settings.game is not None:
        raise ReplayError("--from and --game both say where to begin: give one")
    if settings.once and settings.loop:
        raise ReplayError("--once ends at the end of the log, --loop never: give one")
    if unknown := [name for name in settings.without if name not in SERVICES]:
        raise ReplayError(f"--without {' '.join(unknown)}: there is no such service; there is: {', '.join(SERVICES)}")
    if REFEREE in settings.without:
        raise ReplayError("--without referee: the games of a log are the referee's; a live one would play its own among them")


def _tell(recording: Recording, sessions: Sessions, address: str) -> None:
    duration = clock_text((recording.end - recording.start) / SECOND)
    games = len(recording.games)
    console.print(f"{recording.name}: {duration}, {counted(games, 'game')}", soft_wrap=True, markup=False)
    for name, how in sorted(sessions.cast.replaced.items()):
        console.print(f"  {name}: {how}", markup=False)
    for (key, _), why in sorted(sessions.cast.unplayable.items()):
        console.print(f"  {key} is not played: it {why}", soft_wrap=True, markup=False)
    for text in recording.breaks:
        console.print(f"[yellow]{escape(text)}[/]: what is whole is played", soft_wrap=True)
    if address:
        console.print(f"watch in a browser: [bold]{escape(address)}[/]", soft_wrap=True)


class _Stopping:
    """What a signal does: before the playing, it interrupts; later it ends the playing."""

    def __init__(self) -> None:
        self._calls: list[Callable[[], None]] = []
        self._interrupted = False

    def hand_over(self, *calls: Callable[[], None]) -> None:
        self._calls = list(calls)

    def handle(self, _number: int, _frame: FrameType | None) -> None:
        if not self._calls and not self._interrupted:
            self._interrupted = True
            raise KeyboardInterrupt
        for call in self._calls:
            call()


@contextlib.contextmanager
def _stop_on_signals() -> Iterator[_Stopping]:
    stopping = _Stopping()
    previous = {number: signal.signal(number, stopping.handle) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)}
    try:
        yield stopping
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
