"""The hider's mind as a pure core: looks once, paints the value map over 121 goals, chooses the safest, drives there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from schemas import (
    GOAL_COUNT,
    PRIMITIVES,
    ColorImage,
    Command,
    DepthImage,
    Episode,
    Layout,
    Plan,
    Pose,
    PredictReply,
    PredictRequest,
    StateImage,
    Tick,
)
from services.planner.controller import Controller
from services.planner.declaration import DECLARATION
from services.planner.value_map import Value, checkpoints, choose_goal, values_of
from vantage.perception.seen_map import occupancy_of
from vantage.perception.state_image import perceive
from vantage.service import SECOND, Answered, Arrived, Ask, Publish, Received, Send, StepJoin, Unexpected, Woken
from vantage.world import search
from vantage.world.arena import GOALS
from vantage.world.layout import boxes_of
from vantage.world.motion import heading_number

_RETRY = SECOND // 2

JOINED = ("hider/pose", "hider/depth", "hider/color", "tick")


@dataclass(frozen=True)
class PlannerSettings:
    """How the hider plans. The defaults are the preset `paper`, but for `value` (see there)."""

    checkpoint_interval: int = 10
    """N: steps between the checkpoints at which the value map counts catches."""
    value: Value = "expected"
    """`binary` counts caught checkpoints as the paper does; `expected` adds their probabilities, which ranks goals better."""
    map: Literal["seen", "privileged"] = "seen"
    """Plan over what the camera has seen, or (ablation) over the true layout."""
    maximum_horizon: int = 400
    """Plan at most so many steps ahead: F and T tell no more apart."""
    predictor_timeout: float = 10.0
    """Seconds to wait for the predictor before asking again."""


@dataclass
class _Pending:
    """A question to the predictor that is under way, or to be asked again."""

    token: int
    request: PredictRequest
    pose: Pose
    paths: dict[int, NDArray[np.float64]]
    asked_at: int


class PlannerCore:
    """See module. Plans at the first complete step of an episode that it gets; the goal then stays (reading, row 23).

    In a game that somebody else drives (`players.hider`) it is silent, and keeps nothing.
    """

    declaration = DECLARATION

    def __init__(self, settings: PlannerSettings | None = None) -> None:
        """Raises ValueError when a setting makes no sense."""
        self._settings = settings or PlannerSettings()
        if self._settings.checkpoint_interval < 1 or self._settings.maximum_horizon < 1:
            raise ValueError("--checkpoint-interval and --maximum-horizon must be at least 1 step")
        self._join = StepJoin(JOINED)
        self._episode: Episode | None = None
        self._layout: Layout | None = None
        self._controller = Controller()
        self._pending: _Pending | None = None
        self._plan: Plan | None = None
        self._latest: tuple[Pose, DepthImage] | None = None
        self._tokens = 0
        self._wake: int | None = None

    def wake_at(self) -> int | None:
        return self._wake

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Arrived):
            return self._on_message(received, now)
        if isinstance(received, Answered):
            return self._on_answer(received, now)
        if isinstance(received, Woken) and self._wake is not None and now >= self._wake:
            self._wake = None
            return self._ask(now) if self._pending is not None else ()
        return ()

    def _on_message(self, received: Arrived, now: int) -> Sequence[Send]:
        message = received.message
        if isinstance(message, Layout):
            self._layout = message
            return ()
        if self._episode is None and message.episode == self._join.episode and not isinstance(message, Episode):
            if received.key in JOINED:
                self._join.keep(received.key, message)
            return ()  # the game is over, or somebody else's
        if isinstance(message, Tick) and message.late:
            if message.episode == self._join.episode and "hider" in message.late:
                self._controller.forget_primitive()
            return ()
        if not isinstance(message, Episode):
            complete = self._join.add(received.key, message)
        elif message.phase == "setup" or (message.phase == "running" and message.episode != self._join.episode):
            self._episode = message if message.players.hider == "planner" else None
            self._controller = Controller()
            self._pending = self._plan = self._latest = self._wake = None
            complete = self._join.begin(message.episode)
        else:
            if message.phase in ("ended", "aborted") and message.episode == self._join.episode:
                self._episode = self._pending = self._wake = None
            return ()
        return self._on_step(*complete, now) if complete and self._episode is not None else ()  # type: ignore[call-arg,arg-type]

    def _on_step(self, pose: Pose, depth: DepthImage, color: ColorImage, _tick: object, now: int) -> Sequence[Send]:
        view = perceive(depth, color, pose, "hider")
        other_x, other_y = view.other or (None, None)
        data = view.image.tobytes()
        image = StateImage(stamp=depth.stamp, episode=pose.episode, step=pose.step, data=data, other_x=other_x, other_y=other_y)
        sends: list[Send] = [Publish("hider/view", image)]
        self._latest = (pose, depth)
        if self._plan is not None:
            self._controller.observe(view, pose.x, pose.y, int(heading_number(pose.heading)), pose.step)
            return [*sends, *self._drive()]
        if self._pending is None:
            if self._settings.map == "privileged":
                if self._layout is None or self._layout.episode != pose.episode:
                    raise Unexpected(f"planning with the privileged map, but episode {pose.episode} has published no layout")
                self._controller = Controller(occupancy_of(boxes_of(self._layout)))
            self._controller.observe(view, pose.x, pose.y, int(heading_number(pose.heading)), pose.step)
            self._pending = self._propose(pose, data, now)
            return [*sends, *self._ask(now)]
        return sends

    def _propose(self, pose: Pose, state_image: bytes, now: int) -> _Pending:
        """Plan a path to every goal that is not blocked, to be judged by the predictor."""
        assert self._episode is not None
        heading = int(heading_number(pose.heading))
        horizon = min(max(self._episode.rules.maximum_steps - pose.step, 1), self._settings.maximum_horizon)
        paths = self._controller.proposals(pose.x, pose.y, heading, horizon)
        if not paths:
            paths[_nearest_goal(pose)] = search.roll_out(pose.x, pose.y, heading, np.empty((0, 3)), horizon)
        interval = min(self._settings.checkpoint_interval, horizon)
        positions = np.stack([path[:horizon, :2] for path in paths.values()]).astype(np.float32)  # [paths, horizon, 2]
        request = PredictRequest(
            stamp=pose.stamp,
            episode=pose.episode,
            step=pose.step,
            state_image=state_image,
            path_count=len(paths),
            path_steps=horizon,
            paths=positions.tobytes(),
            horizons=checkpoints(horizon, interval),
        )
        return _Pending(0, request, pose, paths, now)

    def _ask(self, now: int) -> Sequence[Send]:
        assert self._pending is not None
        self._tokens += 1
        self._pending.token = self._tokens
        return (Ask("predictor", self._pending.request, self._settings.predictor_timeout, self._tokens),)

    def _on_answer(self, answered: Answered, now: int) -> Sequence[Send]:
        pending = self._pending
        if pending is None or answered.token != pending.token:
            return ()
        if not isinstance(answered.reply, PredictReply):
            self._wake = now + _RETRY
            raise Unexpected(f"the predictor did not answer ({answered.error}); asking again")
        caught = np.frombuffer(answered.reply.caught, np.float32)
        expected = (pending.request.path_count, len(pending.request.horizons))
        if caught.size != expected[0] * expected[1]:
            self._wake = now + _RETRY
            raise Unexpected(f"the predictor answered {caught.size} probabilities, asked were {expected[0]} x {expected[1]}")
        assert self._latest is not None
        pose, depth = self._latest
        heading = int(heading_number(pose.heading))
        values = np.full(GOAL_COUNT, np.nan)
        values[list(pending.paths)] = values_of(caught.reshape(expected), self._settings.value)
        goal = choose_goal(values, pose.x, pose.y)
        self._controller.go_to(float(GOALS[goal, 0]), float(GOALS[goal, 1]), pose.x, pose.y, heading)
        self._pending = None
        self._plan = Plan(
            stamp=depth.stamp,
            episode=pose.episode,
            step=pose.step,
            horizon=pending.request.path_steps,
            checkpoint_interval=min(self._settings.checkpoint_interval, pending.request.path_steps),
            values=tuple(None if np.isnan(value) else float(value) for value in values),
            goal=goal,
            elapsed=max(0.0, (now - pending.asked_at) / SECOND),
        )
        return self._drive()

    def _drive(self) -> Sequence[Send]:
        assert self._plan is not None and self._latest is not None and self._episode is not None
        pose, depth = self._latest
        heading = int(heading_number(pose.heading))
        primitive = self._controller.drive(pose.x, pose.y, heading)
        sends: list[Send] = []
        if self._controller.path_changed:
            steps = max(self._episode.rules.maximum_steps - pose.step, 0)
            path = self._controller.planned_path(pose.x, pose.y, heading, steps)
            self._plan = replace(self._plan, stamp=depth.stamp, step=pose.step, path=path.astype(np.float32).tobytes())
            sends.append(Publish("hider/plan", self._plan))
        command = Command(stamp=depth.stamp, episode=pose.episode, step=pose.step, primitive=PRIMITIVES[primitive])
        sends.append(Publish("hider/command", command))
        return sends


def _nearest_goal(pose: Pose) -> int:
    """Where nothing can be reached the hider proposes to stay: its cell is the nearest goal."""
    return int(np.argmin(np.hypot(GOALS[:, 0] - pose.x, GOALS[:, 1] - pose.y)))
