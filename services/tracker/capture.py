"""The capture of one step: the first frames of all cameras after both robots came to rest, as the messages of that step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from schemas import ROBOTS, ColorImage, DepthImage, Intrinsics, Message, Pose
from vantage.service import Publish, Send
from vantage.tracking.overhead import TrackState


class RawFrame(NamedTuple):
    """One frame of an RGB-D camera as it came: depth uint16 [H, W] mm, color uint8 [H, W, 3] RGB, stamp of the capture (ns)."""

    stamp: int
    depth: npt.NDArray[np.uint16]
    color: npt.NDArray[np.uint8]


class Picture(NamedTuple):
    """A frame made ready for the players: registered, level, at their resolution."""

    stamp: int
    depth: npt.NDArray[np.uint16]
    color: npt.NDArray[np.uint8]
    intrinsics: Intrinsics


@dataclass
class StepCapture:
    """What is known of one step so far. Frames captured before `after`, when the later motion ended, do not count.

    Attributes:
        after: when the later motion had ended, own clock, ns.
    """

    episode: int
    step: int
    after: int
    _poses: dict[str, TrackState] = field(default_factory=dict)
    _pictures: dict[str, Picture] = field(default_factory=dict)

    def see(self, tracks: Mapping[str, TrackState | None], stamp: int) -> None:
        """Take in what an overhead frame showed: the first one with a robot's tag in it says where that robot is."""
        if stamp <= self.after:
            return
        for robot, track in tracks.items():
            if track is not None and track.seen:
                self._poses.setdefault(robot, track)

    def wants(self, robot: str, stamp: int) -> bool:
        """Whether a frame of this robot's camera with this stamp is the one to be made ready."""
        return stamp > self.after and robot not in self._pictures

    def look(self, robot: str, picture: Picture) -> None:
        """Take in a robot's picture."""
        self._pictures[robot] = picture

    @property
    def complete(self) -> bool:
        """Whether poses and pictures of both robots are there."""
        return len(self._poses) == len(ROBOTS) == len(self._pictures)

    def messages(self) -> list[Send]:
        """Return the step's messages. The poses go last: who has them knows that the pictures are out."""
        pictures: list[Send] = []
        poses: list[Send] = []
        for robot in ROBOTS:
            stamp, depth, color, intrinsics = self._pictures[robot]
            place = {"episode": self.episode, "step": self.step}
            size = {"stamp": stamp, "width": depth.shape[1], "height": depth.shape[0], "intrinsics": intrinsics}
            images: tuple[tuple[str, Message], ...] = (
                ("depth", DepthImage(**place, **size, data=depth.tobytes())),  # type: ignore[arg-type]
                ("color", ColorImage(**place, **size, data=color.tobytes())),  # type: ignore[arg-type]
            )
            pictures.extend(Publish(f"{robot}/{part}", image) for part, image in images)
            track = self._poses[robot]
            heading = math.remainder(track.heading, math.tau)
            poses.append(Publish(f"{robot}/pose", Pose(**place, stamp=track.stamp, x=track.x, y=track.y, heading=heading)))
        return pictures + poses
