"""The physical world as a pure core: both robots' bodies and cameras, and the boxes they move among."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from schemas import (
    PRIMITIVES,
    ROBOTS,
    ColorImage,
    Command,
    DepthImage,
    Episode,
    Layout,
    Message,
    Pose,
    Tick,
)
from services.simulator.declaration import DECLARATION
from vantage.service import Arrived, Publish, Received, Send, Unexpected
from vantage.world import arena
from vantage.world.camera import Camera, render
from vantage.world.game import move_both
from vantage.world.layout import boxes_of, make_layout
from vantage.world.start import draw_start

_NUMBER_OF_PRIMITIVE = {name: number for number, name in enumerate(PRIMITIVES)}


@dataclass(frozen=True)
class SimulatorSettings:
    """The world's cameras."""

    camera: Camera = field(default_factory=Camera)
    """The RGB-D camera on each robot."""


class SimulatorCore:
    """See module. Poses are float64 [2, 3]: x, y in metres and the heading in units of 10 degrees; row 0 is the hider."""

    declaration = DECLARATION

    def __init__(self, settings: SimulatorSettings | None = None) -> None:
        self._settings = settings or SimulatorSettings()
        camera = self._settings.camera
        self._intrinsics = camera.intrinsics()
        self._depth = np.zeros((camera.height, camera.width), np.uint16)
        self._color = np.zeros((camera.height, camera.width, 3), np.uint8)
        self._episode: Episode | None = None
        self._layout = Layout(stamp=0)
        self._boxes = np.zeros((0, 7))
        self._poses = np.zeros((2, 3))
        self._next_poses = np.zeros((2, 3))
        self._moved = np.zeros(2, np.bool_)
        self._step = 0
        self._commands: dict[str, int] = {}

    def wake_at(self) -> int | None:
        return None

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if not isinstance(received, Arrived):
            return ()
        message = received.message
        if isinstance(message, Command):
            return self._on_command(received.key.partition("/")[0], message, now)
        if isinstance(message, Episode):
            return self._on_episode(message, now)
        if isinstance(message, Tick):
            return self._on_tick(message, now)
        return ()

    def _on_episode(self, episode: Episode, now: int) -> Sequence[Send]:
        if episode.phase == "setup":
            return self._set_up(episode, now)
        if self._episode is not None and episode.episode == self._episode.episode and episode.phase in ("ended", "aborted"):
            self._episode = None
        return ()

    def _set_up(self, episode: Episode, now: int) -> Sequence[Send]:
        self._episode = None
        obstacles = make_layout(episode.rules.layout, episode.seed)
        self._layout = Layout(stamp=now, episode=episode.episode, obstacles=obstacles)
        self._boxes = boxes_of(self._layout)
        start = draw_start(
            self._boxes,
            self._layout.width,
            self._layout.depth,
            episode.seed,
            episode.rules.start_distance_minimum,
            episode.rules.start_distance_maximum,
        )
        self._poses[:] = start
        self._episode = episode
        self._step = 0
        self._commands.clear()
        return [Publish("layout", self._layout), *self._sense(now)]

    def _on_command(self, robot: str, command: Command, now: int) -> Sequence[Send]:
        if self._episode is None or command.episode != self._episode.episode or command.step != self._step:
            raise Unexpected(
                f"{robot}/command for episode {command.episode} step {command.step}, the world is at step {self._step}"
            )
        if robot in self._commands:
            raise Unexpected(f"a second {robot}/command for step {command.step}")
        self._commands[robot] = _NUMBER_OF_PRIMITIVE[command.primitive]
        return self._advance_if_complete(now)

    def _on_tick(self, tick: Tick, now: int) -> Sequence[Send]:
        if self._episode is None or tick.episode != self._episode.episode or tick.step != self._step:
            if tick.late or self._episode is None or tick.episode != self._episode.episode:
                raise Unexpected(f"tick of episode {tick.episode} step {tick.step}, the world is at step {self._step}")
            return ()  # a tick that opens a step may come after the commands it led to
        for robot in tick.late:
            self._commands.setdefault(robot, arena.STAY)
        return self._advance_if_complete(now)

    def _advance_if_complete(self, now: int) -> Sequence[Send]:
        if len(self._commands) < len(ROBOTS):
            return ()
        primitives = np.array([self._commands[robot] for robot in ROBOTS], np.int64)
        self._commands.clear()
        move_both(self._boxes, self._layout.width, self._layout.depth, self._poses, primitives, self._next_poses, self._moved)
        self._poses, self._next_poses = self._next_poses, self._poses
        self._step += 1
        return self._sense(now)

    def _sense(self, now: int) -> list[Send]:
        """Look through both cameras. The poses go last: who has them knows that the pictures are out."""
        assert self._episode is not None
        camera = self._settings.camera
        place = {"stamp": now, "episode": self._episode.episode, "step": self._step}
        pictures: list[Send] = []
        poses: list[Send] = []
        for index, robot in enumerate(ROBOTS):
            other = 1 - index
            x, y, heading = self._poses[index].tolist()
            angle = radians_of(heading)
            render(
                camera,
                self._boxes,
                self._layout.width,
                self._layout.depth,
                x,
                y,
                angle,
                self._poses[other, 0],
                self._poses[other, 1],
                other,
                self._episode.seed,
                self._step,
                index,
                self._depth,
                self._color,
            )
            size = {"width": camera.width, "height": camera.height, "intrinsics": self._intrinsics}
            images: tuple[tuple[str, Message], ...] = (
                ("depth", DepthImage(**place, **size, data=self._depth.tobytes())),  # type: ignore[arg-type]
                ("color", ColorImage(**place, **size, data=self._color.tobytes())),  # type: ignore[arg-type]
            )
            pictures.extend(Publish(f"{robot}/{part}", image) for part, image in images)
            poses.append(Publish(f"{robot}/pose", Pose(**place, x=x, y=y, heading=angle)))
        return pictures + poses


def radians_of(heading: float) -> float:
    """Return a heading number (units of 10 degrees) as radians in [-pi, pi]."""
    angle = heading * math.radians(10.0)
    return angle - math.tau if angle > math.pi else angle
