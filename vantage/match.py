"""A match: a number of games asked for on a bus, followed to their end."""

from __future__ import annotations

import time
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec

from schemas import TOPICS, Control, Episode, MalformedMessage, Message, Plan, Players, Rules, Tick, decode, encode
from schemas.messages import MAXIMUM_STEPS
from vantage.bus import Alive, Bus, Event, Sample
from vantage.deployment import DeploymentError
from vantage.errors import UserError
from vantage.printable import counted, printable

SeekerPreset = Literal["glancing", "expert"]

PATIENCE = 60.0
"""Seconds within which the referee must set a game up."""
REPEAT = 2.0
"""Seconds after which a request that set nothing up is made again: the referee may have been restarted meanwhile."""
GOODBYE = 0.7
"""Seconds that a game which is stopped may take to end, before the command does."""
DELIVERY = 0.3
"""Seconds that the bus gets to deliver a `stop` that no game answers, before it may be closed."""
MOST_GAMES = 1_000_000


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

    Its games are those that carry its request. Repeating a request is idempotent.

    Args:
        bus: an open session named `command-line`, used for nothing else.
        ask: what to ask for.
    """

    def __init__(self, bus: Bus, ask: Control) -> None:
        self._bus = bus
        self._ask = msgspec.structs.replace(ask, request=ask.request or uuid.uuid4().hex)
        self.games: list[Game] = []
        self.current: Episode | None = None
        self.step = 0
        self.ended_early = ""
        """Why no more games follow, although not all have been played."""
        self._plan: Plan | None = None
        self._referee = False
        self._idle_since = time.monotonic()
        self._ask_at = self._idle_since
        self._asked = False
        self._paused = False
        bus.subscribe("episode", "tick", "hider/plan", "control")
        bus.watch()

    @property
    def steps(self) -> int:
        """Steps that the hider has to survive."""
        return self._ask.rules.maximum_steps

    @property
    def over(self) -> bool:
        """Whether no game is under way and none follows."""
        return self.current is None and (len(self.games) >= self._ask.games or bool(self.ended_early))

    def turn(self, timeout: float = 0.1) -> bool:
        """Take in one event, and ask (again) where no game is under way. Returns whether there was an event.

        Raises:
            DeploymentError: the referee sets no game up, or a log is being replayed.
        """
        now = time.monotonic()
        if self.current is None and not self.over:
            if self._paused:
                self._idle_since = now  # the referee sets nothing up until it is resumed
            if now - self._idle_since > PATIENCE:
                raise DeploymentError(
                    f"no game was set up within {PATIENCE:g} s: look at `vantage status` and `vantage logs referee`"
                )
            if now >= self._ask_at and self._referee:
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

    def stop(self, reason: str) -> None:
        """Stop the games, and wait a moment for the end of the one under way."""
        if not self._asked or self.over:
            return
        self._bus.publish("control", Control(stamp=time.time_ns(), action="stop", request=self._ask.request, reason=reason))
        self.ended_early = reason
        began = time.monotonic()
        least = DELIVERY if self.current is None else 0.0
        while (left := (least if self.current is None else GOODBYE) - (time.monotonic() - began)) > 0:
            self.turn(min(left, 0.1))

    def _take(self, event: Event) -> None:
        if isinstance(event, Alive):
            self._on_change(event)
        if not isinstance(event, Sample) or event.publisher not in TOPICS[event.key].publishers:
            return
        try:
            message: Message = event.decode()
        except MalformedMessage:
            return
        if isinstance(message, Episode):
            self._on_episode(message)
        elif isinstance(message, Control):
            self._on_control(message)
        elif self.current is not None and message.episode == self.current.episode:
            if isinstance(message, Tick):
                self.step = max(self.step, message.step)
            elif isinstance(message, Plan):
                self._plan = message

    def _on_change(self, event: Alive) -> None:
        if event.name == "replay" and event.alive:
            raise DeploymentError("a log is being replayed here, and its games are not yours: end the replay, or play elsewhere")
        if event.name != "referee":
            return
        self._referee = event.alive
        if not event.alive:
            self._paused = False
            if self.current is not None:
                self._finish(msgspec.structs.replace(self.current, phase="aborted", step=self.step, reason="the referee died"))
            # The next referee knows nothing of our wish.
            self._ask_at = time.monotonic() + 1.0

    def _on_episode(self, episode: Episode) -> None:
        if episode.request != self._ask.request:
            return
        self._paused = episode.paused
        if episode.phase == "setup":
            self.current, self._plan, self.step = episode, None, 0
        elif self.current is not None and episode.episode == self.current.episode:
            self.current = episode
            if episode.phase in ("ended", "aborted"):
                self._finish(episode)

    def _on_control(self, control: Control) -> None:
        """Handle another participant's start or stop: it ends this match. Take note of a pause."""
        own = control.request == self._ask.request
        if control.action == "pause":
            self._paused = True
        elif control.action == "resume" or (control.action == "start" and not own) or (control.action == "stop" and own):
            self._paused = False
        if not self._asked or self.ended_early:
            return
        if control.action == "stop" and control.request in ("", self._ask.request):
            self.ended_early = printable(control.reason) or "somebody has stopped them"
        elif control.action == "start" and control.request != self._ask.request:
            self.ended_early = "somebody has asked for other games"

    def _finish(self, episode: Episode) -> None:
        plan = self._plan
        self.games.append(Game(episode, plan.elapsed if plan else None, plan.goal if plan else None))
        self.current = None
        self._idle_since = time.monotonic()
        self._ask_at = self._idle_since + REPEAT


def sentence(game: Game) -> str:
    """Return one line on how a game went."""
    from vantage.world.arena import goal_name

    episode = game.episode
    if episode.phase == "aborted":
        return f"game {episode.episode} (seed {episode.seed}): aborted at step {episode.step}: {printable(episode.reason)}"
    steps = counted(episode.step, "step")
    ending = f"was caught at step {episode.caught_step}" if episode.outcome == "caught" else f"survived {steps}"
    plan = "" if game.planned is None else f", planned in {game.planned:.2f} s"
    plan += "" if game.goal is None else f", {goal_name(game.goal)}"
    return f"game {episode.episode} (seed {episode.seed}): the hider {ending}{plan}"


def wish(seed: int, games: int, steps: int, period: float, layout: str, players: Players) -> Control:
    """Return the request for some games; a layout file is named so that the table finds it from its own folder.

    Raises:
        DeploymentError: nobody could play such a game.
    """
    _require("--seed", seed, 0, 2**63 - 1 - MOST_GAMES)
    _require("--games", games, 1, MOST_GAMES)
    _require("--steps", steps, 1, MAXIMUM_STEPS)
    _require("--period", period, 0, 3600)
    if Path(layout).is_file():
        from vantage.world.layout import ImpossibleLayout, make_layout  # kernels: only who brings a file waits for them

        layout = str(Path(layout).absolute())
        try:
            make_layout(layout, seed)
        except ImpossibleLayout as error:
            raise DeploymentError(str(error)) from None
    elif layout not in ("random", "lab"):
        raise DeploymentError(f"there is no layout {layout!r}: give `random`, `lab` or the path of a layout file")
    rules = Rules(maximum_steps=steps, layout=layout, step_period=period)
    ask = Control(
        stamp=time.time_ns(), action="start", seed=seed, games=games, rules=rules, players=players, request=uuid.uuid4().hex
    )
    try:
        return decode(Control, encode(ask))
    except (MalformedMessage, OverflowError) as error:
        raise DeploymentError(f"no such game can be played: {error}") from None


def _require(option: str, value: float, lowest: int, highest: int) -> None:
    if not lowest <= value <= highest:
        raise UserError(f"{option} must be {lowest} to {highest}, not {value:g}")
