"""`vantage play`: ask the referee of a running deployment for games, and show how they go."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from schemas import TOPICS, Control, Episode, MalformedMessage, Message, Plan, Players, Rules, Tick, decode, encode
from vantage.bus import Alive, Bus, Event, Sample
from vantage.deployment import Deployment, DeploymentError, deployments

console = Console(highlight=False)

SeekerPreset = Literal["glancing", "expert"]

PATIENCE = 15.0
"""Seconds within which the referee must set a game up."""
REPEAT = 5.0
"""Seconds after which a request that set nothing up is made again: the referee may have been restarted meanwhile."""


@dataclass(frozen=True)
class Settings:
    """Play games on a running deployment and show how they go.

    Examples:
        vantage play
        vantage play --seed 7 --games 3
        vantage play --seed 7 --seeker expert --steps 200 --layout lab
        vantage play --games 20 --period 0        as fast as the players answer
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
    """Policy of the hider."""
    seeker: SeekerPreset = "glancing"
    """Preset of the seeker."""
    period: float = 0.25
    """Seconds a step; 0 = as fast as the players answer."""
    deployment: str | None = None
    """The deployment to play on; default: the one that is up."""
    folder: Path | None = None
    """Its private runtime folder, as given to `vantage up`."""
    arena: str = "table"
    """Name of its arena."""


@dataclass(slots=True)
class Game:
    """How one game ended.

    Attributes:
        planned: s that the hider took to plan, None when it published no plan.
    """

    episode: Episode
    planned: float | None
    goal: int | None


class Match:
    """A number of games on a bus: asks for them, follows them, and asks again for the rest if the referee was restarted.

    Args:
        bus: an open session named `command-line`.
        ask: what to ask for.
    """

    def __init__(self, bus: Bus, ask: Control) -> None:
        self._bus = bus
        self._ask = ask
        self.games: list[Game] = []
        self.current: Episode | None = None
        self.step = 0
        self._plan: Plan | None = None
        self._idle_since = time.monotonic()
        self._ask_at = self._idle_since
        self._asked = False
        bus.subscribe("episode", "tick", "hider/plan")
        bus.watch()

    @property
    def over(self) -> bool:
        """Whether all games have been played."""
        return len(self.games) >= self._ask.games

    def turn(self, timeout: float = 0.1) -> bool:
        """Take in one event, and ask (again) where no game is under way. Returns whether there was an event.

        Raises:
            DeploymentError: the referee sets no game up, or a log is being replayed.
        """
        now = time.monotonic()
        if self.current is None and not self.over:
            if now - self._idle_since > PATIENCE:
                raise DeploymentError(
                    f"no game was set up within {PATIENCE:g} s: look at `vantage status` and `vantage logs referee`"
                )
            if now >= self._ask_at and self._bus.has_reader("control"):
                self._ask_at = now + REPEAT
                self._asked = True
                done = len(self.games)
                rest = msgspec.structs.replace(
                    self._ask, stamp=time.time_ns(), seed=self._ask.seed + done, games=self._ask.games - done
                )
                self._bus.publish("control", rest)
        event = self._bus.receive(timeout)
        if event is not None:
            self._take(event)
        return event is not None

    def _take(self, event: Event) -> None:
        if isinstance(event, Alive) and event.name == "replay" and event.alive:
            raise DeploymentError("a log is being replayed here, and its games are not yours: end the replay, or play elsewhere")
        if isinstance(event, Alive) and event.name == "referee" and not event.alive:
            if self.current is not None:
                self._finish(msgspec.structs.replace(self.current, phase="aborted", step=self.step, reason="the referee died"))
            # The next referee knows nothing of our wish.
            self._ask_at = time.monotonic() + 1.0
        if not isinstance(event, Sample) or event.publisher not in TOPICS[event.key].publishers:
            return
        try:
            message: Message = event.decode()
        except MalformedMessage:
            return
        if isinstance(message, Episode):
            self._on_episode(message)
        elif self.current is not None and message.episode == self.current.episode:
            if isinstance(message, Tick):
                self.step = max(self.step, message.step)
            elif isinstance(message, Plan):
                self._plan = message

    def _on_episode(self, episode: Episode) -> None:
        if not self._asked:
            return  # of an earlier game
        if episode.phase == "setup":
            self.current, self._plan, self.step = episode, None, 0
        elif self.current is not None and episode.episode == self.current.episode and episode.phase in ("ended", "aborted"):
            self._finish(episode)

    def _finish(self, episode: Episode) -> None:
        plan = self._plan
        self.games.append(Game(episode, plan.elapsed if plan else None, plan.goal if plan else None))
        self.current = None
        self._idle_since = time.monotonic()
        self._ask_at = self._idle_since + REPEAT


def sentence(game: Game) -> str:
    """Return one line that says how a game went."""
    episode = game.episode
    if episode.phase == "aborted":
        return f"game {episode.episode} (seed {episode.seed}): aborted at step {episode.step}: {episode.reason}"
    ending = f"was caught at step {episode.caught_step}" if episode.outcome == "caught" else f"survived {episode.step} steps"
    plan = "" if game.planned is None else f", planned in {game.planned:.2f} s, goal {game.goal}"
    return f"game {episode.episode} (seed {episode.seed}): the hider {ending}{plan}"


def play(bus: Bus, ask: Control) -> Sequence[Game]:
    """Play the games that `ask` names and show how they go. Returns how each ended.

    Raises:
        DeploymentError: the referee sets no game up.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("step {task.completed:.0f} of {task.total:.0f}"),
        TimeElapsedColumn(),
    )
    match = Match(bus, ask)
    told = 0
    with Progress(*columns, console=console, transient=True) as progress:
        bar: TaskID = progress.add_task("asking the referee", total=ask.rules.maximum_steps)
        while not match.over:
            match.turn()
            if match.current is not None:
                doing = "planning" if match.step == 0 else "playing"
                progress.update(
                    bar, description=f"game {match.current.episode} (seed {match.current.seed}): {doing}", completed=match.step
                )
            for game in match.games[told:]:
                told += 1
                progress.console.print(sentence(game), soft_wrap=True)
    return match.games


def wish(seed: int, games: int, rules: Rules, players: Players) -> Control:
    """Return the request for some games; a layout file is named so that the table finds it from its own folder.

    Raises:
        DeploymentError: nobody could play such a game.
    """
    if Path(rules.layout).is_file():
        from vantage.world.layout import ImpossibleLayout, make_layout  # kernels: only who brings a file waits for them

        rules = msgspec.structs.replace(rules, layout=str(Path(rules.layout).absolute()))
        try:
            make_layout(rules.layout, seed)
        except ImpossibleLayout as error:
            raise DeploymentError(str(error)) from None
    elif rules.layout not in ("random", "lab"):
        raise DeploymentError(f"there is no layout {rules.layout!r}: give `random`, `lab` or the path of a layout file")
    ask = Control(stamp=time.time_ns(), action="start", seed=seed, games=games, rules=rules, players=players)
    try:
        return decode(Control, encode(ask))
    except (MalformedMessage, OverflowError) as error:
        raise DeploymentError(f"no such game can be played: {error}") from None


def _find(settings: Settings) -> Deployment:
    """Return the deployment that was named, else the one that is up, else the simulation."""
    if settings.deployment is not None:
        return Deployment(settings.deployment, settings.folder)
    up = [deployment for name in deployments() if (deployment := Deployment(name, settings.folder)).is_running()]
    return up[0] if len(up) == 1 else Deployment("simulation", settings.folder)


def main(settings: Settings) -> int:
    """Play; 0 if no game was aborted."""
    from vantage.bus.zenoh_bus import ZenohBus

    rules = Rules(maximum_steps=settings.steps, layout=settings.layout, step_period=settings.period)
    ask = wish(settings.seed, settings.games, rules, Players(hider=settings.hider, seeker=settings.seeker))
    deployment = _find(settings)
    if not deployment.folder.is_dir():
        raise DeploymentError(f"{deployment.name} is not up in {deployment.folder}: start it with `{deployment.command('up')}`")
    with ZenohBus("command-line", deployment.folder, settings.arena) as bus:
        games = play(bus, ask)
    return 1 if any(game.episode.phase == "aborted" for game in games) else 0
