"""What a replay shows in the terminal: one line that lives where there is one, else a line a game."""

from __future__ import annotations

from rich.console import Console
from rich.live import Live
from rich.text import Text

from schemas import Playback
from vantage.replay.keys import HELP

SIGNS = {"playing": "▶", "paused": "⏸", "ended": "■"}


def clock_text(seconds: float) -> str:
    """Return `m:ss.t`, or `h:mm:ss.t`."""
    tenths = int(seconds * 10 + 1e-6)
    minutes, rest = divmod(tenths, 600)
    hours, minutes = divmod(minutes, 60)
    end = f"{rest // 10:02d}.{rest % 10}"
    return f"{hours}:{minutes:02d}:{end}" if hours else f"{minutes}:{end}"


def line(report: Playback, game: int | None, games: int) -> str:
    """Return how a replay stands. `game` is the index of the game reached, `games` how many there are."""
    place = "no game yet" if game is None else f"game {report.episode} ({game + 1} of {games})  step {report.step}"
    if not games:
        place = "no game in it"
    times = f"{clock_text(report.position)} / {clock_text(report.duration)}"
    return f"{SIGNS[report.state]} {times}  {place}  x{report.speed:g}  {report.state}"


class Display:
    """See the module. Use as a context manager.

    Args:
        console: where.
        keys: whether keys are heard, so that they are named.
    """

    def __init__(self, console: Console, keys: bool) -> None:
        self._console = console
        self._keys = keys
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        self._told: tuple[int | None, str, int] | None = None

    def __enter__(self) -> Display:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, report: Playback, game: int | None, games: int) -> None:
        """Show how it stands now."""
        text = line(report, game, games)
        if self._live is not None:
            self._live.update(Text(f"{text}   {HELP}" if self._keys else text, no_wrap=True, overflow="ellipsis"), refresh=True)
            return
        told = game, report.state, report.jumps
        if told != self._told:
            self._told = told
            self._console.print(text, soft_wrap=True)

    def say(self, text: str) -> None:
        """Print a line above."""
        self._console.print(text, soft_wrap=True, markup=False)
