"""`vantage play`: ask the referee of a running deployment for games, and show how they go. `vantage stop`: end them."""

from __future__ import annotations

import contextlib
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import msgspec
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from schemas import Control, Episode, MalformedMessage, Players
from schemas.topics import COMMAND_LINE
from vantage.bus import Alive, Bus, NameInUse, Sample
from vantage.deployment import DEPLOYMENT_NAME, Deployment, DeploymentError, deployments
from vantage.match import GOODBYE, Game, Match, SeekerPreset, sentence, wish
from vantage.printable import counted, printable
from vantage.stopping import stop_deferred, stop_requested

console = Console(highlight=False)

HUMAN = "human"
"""Driver of the hider that sits at the console's page."""
PLAYER, STOPPER = COMMAND_LINE
REFEREE_PATIENCE = 5.0
"""Seconds within which a referee must be seen that is to stop games."""
LATCHED_PATIENCE = 0.5
"""Seconds in which the bus brings what was published last, and takes a message along."""


@dataclass(frozen=True)
class Settings:
    """Play games on a running deployment and show how they go.

    The games end with this command: on Ctrl-C, or when its terminal is closed, the one under way is stopped at once.

    Examples:
        vantage play
        vantage play --seed 7 --games 3
        vantage play --seed 7 --seeker expert --steps 200 --layout lab
        vantage play --games 20 --period 0        as fast as the players answer
        vantage play --games 500 --detach         go on without this terminal, until `vantage stop`
        vantage play --deployment rehearsal
    """

    seed: int = 1
    """Seed of the first game; game n has seed + n - 1."""
    games: int = 1
    """How many games."""
    steps: int = 100
    """Steps the hider has to survive (T)."""
    layout: str = "random"
    """Arena: `random`, `lab`, or the path of a layout file."""
    hider: str = "planner"
    """Policy of the hider: `planner`, or `human` at the console's page."""
    seeker: SeekerPreset = "glancing"
    """Preset of the seeker."""
    period: float = 0.25
    """Seconds a step; 0 = as fast as the players answer."""
    detach: bool = False
    """Ask for the games and leave: they go on without this command."""
    deployment: str | None = None
    """The deployment to play on; default: the one that is up."""
    folder: Path | None = None
    """Its private runtime folder, as given to `vantage up`."""
    arena: str = "table"
    """Name of its arena."""


@dataclass(frozen=True)
class StopSettings:
    """End the games of a running deployment, whoever asked for them: the one under way, and all that are to follow.

    Examples:
        vantage stop
        vantage stop --deployment rehearsal
    """

    deployment: str | None = None
    """The deployment on which games are played; default: the one that is up."""
    folder: Path | None = None
    """Its private runtime folder, as given to `vantage up`."""
    arena: str = "table"
    """Name of its arena."""


def play(match: Match, page: str = "") -> Sequence[Game]:
    """Play a match and show how it goes. Returns how each game ended.

    Args:
        page: address of the console's page, for games that a human drives.

    Raises:
        DeploymentError: the referee sets no game up.
        KeyboardInterrupt: a stop signal arrived; the games have ended.
    """
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("step {task.completed:.0f} of {task.total:.0f}"),
        TimeElapsedColumn(),
    )
    shown = 0
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        bar: TaskID = progress.add_task("asking the referee", total=match.steps)
        while not match.over:
            if stop_requested():
                raise KeyboardInterrupt
            match.turn()
            if match.current is not None:
                episode = match.current
                doing = "planning" if match.step == 0 else "playing"
                if episode.paused:
                    doing = f"paused; drive at {page}" if page else "paused"
                description = f"game {episode.episode} (seed {episode.seed}): {doing}"
                progress.update(bar, description=description, completed=match.step)
            for game in match.games[shown:]:
                shown += 1
                progress.console.print(sentence(game), soft_wrap=True, markup=False)
    return match.games


def find_running(name: str | None, folder: Path | None) -> Deployment:
    """Return the deployment of a name, or in a folder, or the only one that is up.

    Raises:
        DeploymentError: it is not up, or several are and no name tells which.
    """
    if name is None and folder is not None:
        with contextlib.suppress(OSError, UnicodeDecodeError):
            name = (folder / DEPLOYMENT_NAME).read_text().strip()
        name = name if name in deployments() else None
    names = [name or "simulation"] if name or folder else deployments()
    up = [deployment for each in names if (deployment := Deployment(each, folder)).is_running()]
    if len(up) > 1:
        listed = ", ".join(deployment.name for deployment in up)
        raise DeploymentError(f"several deployments are up ({listed}): choose one with --deployment")
    if not up:
        deployment = Deployment(names[0] if len(names) == 1 else "simulation", folder)
        here = f"{deployment.name} is not up in {deployment.folder}" if len(names) == 1 else "no deployment is up"
        raise DeploymentError(f"{here}: start it with `{deployment.command('up')}`")
    return up[0]


@contextlib.contextmanager
def _session(name: str, deployment: Deployment, arena: str) -> Iterator[Bus]:
    from vantage.bus.zenoh_bus import ZenohBus

    try:
        bus = ZenohBus(name, deployment.folder, arena)
    except NameInUse:
        trouble = "games are being asked for" if name == PLAYER else "games are being stopped"
        raise DeploymentError(
            f"{trouble} in {deployment.folder} by another command: wait until it ends, or end its games with `vantage stop`"
        ) from None
    with bus:
        yield bus


def main(settings: Settings) -> int:
    """Play; 0 if all games were played and none was aborted."""
    players = Players(hider=settings.hider, seeker=settings.seeker)
    ask = wish(settings.seed, settings.games, settings.steps, settings.period, settings.layout, players)
    deployment = find_running(settings.deployment, settings.folder)
    page = deployment.console_address()
    if not settings.detach:
        ask = msgspec.structs.replace(ask, owner=PLAYER)
    if settings.hider == HUMAN:
        where = f"open {page} and press an arrow key there" if page else "this deployment has no console"
        console.print(f"a human drives the hider: {where}", soft_wrap=True, markup=False)
    with _session(PLAYER, deployment, settings.arena) as bus, stop_deferred():
        match = Match(bus, ask)
        try:
            if settings.detach:
                return _detach(match, settings, page)
            games = play(match, page if settings.hider == HUMAN else "")
        except BaseException as error:  # also the terminal's, when that is closed
            played = len(match.games)
            match.stop("`vantage play` has ended")
            if isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(_how_to_go_on(settings, played)) from None
            raise
    if match.ended_early:
        left = settings.games - len(games)
        console.print(f"{left} of {counted(settings.games, 'game')} not begun: {match.ended_early}", soft_wrap=True, markup=False)
    return 1 if match.ended_early or any(game.episode.phase == "aborted" for game in games) else 0


def _detach(match: Match, settings: Settings, page: str) -> int:
    """Return once the first game is set up.

    Raises:
        DeploymentError: another participant stopped the games first.
    """
    while match.current is None and not match.over:
        if stop_requested():
            raise KeyboardInterrupt
        match.turn()
    if match.ended_early:
        raise DeploymentError(f"the games were stopped: {match.ended_early}")
    watch = f"watch at {page}" if page else "see `vantage status`"
    games = f"{counted(settings.games, 'game')} from seed {settings.seed}"
    console.print(f"{games} asked for: {watch}, end with `{_command('stop', settings)}`", soft_wrap=True, markup=False)
    return 0


def stop(settings: StopSettings) -> int:
    """End the games; 0 also if none was being played.

    Raises:
        DeploymentError: nothing is up, or the referee does not answer.
    """
    deployment = find_running(settings.deployment, settings.folder)
    with _session(STOPPER, deployment, settings.arena) as bus:
        bus.subscribe("episode")
        bus.watch()
        onlooker = _Onlooker(bus)
        if not onlooker.listen(lambda: onlooker.referee, REFEREE_PATIENCE):
            raise DeploymentError("the referee is not there: look at `vantage status`")
        onlooker.listen(lambda: onlooker.episode is not None, LATCHED_PATIENCE)
        playing = onlooker.is_playing
        bus.publish("control", Control(stamp=time.time_ns(), action="stop", reason="`vantage stop`"))
        ended = onlooker.listen(lambda: playing and not onlooker.is_playing, GOODBYE if playing else LATCHED_PATIENCE)
    if playing and not ended:
        raise DeploymentError("the game did not end: look at `vantage status`")
    episode = onlooker.episode
    if playing and episode is not None:
        reason = f" ({printable(episode.reason)})" if episode.phase == "ended" else ""
        line = f"game {episode.episode} (seed {episode.seed}) has ended at step {episode.step}{reason}; none follows"
        console.print(line, soft_wrap=True, markup=False)
    else:
        console.print("no game was being played; none follows")
    return 0


class _Onlooker:
    """Whether there is a referee, and what it last published of a game."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.referee = False
        self.episode: Episode | None = None

    @property
    def is_playing(self) -> bool:
        return self.episode is not None and self.episode.phase in ("setup", "running")

    def listen(self, done: Callable[[], bool], seconds: float) -> bool:
        """Take in what comes until something is so, or `seconds` are over; return whether it is."""
        end = time.monotonic() + seconds
        while not done() and (left := end - time.monotonic()) > 0:
            event = self._bus.receive(left)
            if isinstance(event, Alive) and event.name == "referee":
                self.referee = event.alive
            elif isinstance(event, Sample) and event.publisher == "referee":
                with contextlib.suppress(MalformedMessage):
                    message = event.decode()
                    self.episode = message if isinstance(message, Episode) else self.episode
        return done()


def _how_to_go_on(settings: Settings, played: int) -> str:
    """Return what a command that was ended leaves, and what to type for the rest."""
    rest = _command("play", settings, seed=settings.seed + played, games=settings.games - played)
    return f"{played} of {counted(settings.games, 'game')} played, the others: {rest}"


def _command(word: str, settings: Settings, **changes: int) -> str:
    """Return what to type for another command on the same deployment; `play` keeps its options but for `changes`."""
    words = ["vantage", word]
    for field in fields(settings):
        value = changes.get(field.name, getattr(settings, field.name))
        if value == field.default or (word != "play" and field.name not in ("deployment", "folder", "arena")):
            continue
        words += [f"--{field.name}"] if value is True else [f"--{field.name}", str(value)]
    return shlex.join(words)
