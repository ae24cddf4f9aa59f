"""Where the robots have been in the present game, for a page that comes in the middle of it."""

from __future__ import annotations

from schemas import ROBOTS, Pose
from services.console.frames import frame
from services.console.requests import STEPS_LIMIT


class Driven:
    """The poses of one episode; the oldest go beyond `STEPS_LIMIT` steps."""

    def __init__(self) -> None:
        self._episode = 0
        self._paths: dict[str, dict[int, tuple[float, float]]] = {robot: {} for robot in ROBOTS}

    def add(self, robot: str, pose: Pose) -> None:
        """Keep a pose; the first of another episode puts those of the last one away."""
        if pose.episode != self._episode:
            self.forget()
            self._episode = pose.episode
        path = self._paths[robot]
        path.pop(pose.step, None)
        path[pose.step] = round(pose.x, 4), round(pose.y, 4)
        if len(path) > STEPS_LIMIT:
            del path[next(iter(path))]

    def forget(self) -> None:
        """Put everything away."""
        self._episode = 0
        for path in self._paths.values():
            path.clear()

    def frame(self) -> bytes | None:
        """Return the frame `driven`; None before any pose."""
        if not any(self._paths.values()):
            return None
        paths = {robot: [(step, *place) for step, place in sorted(path.items())] for robot, path in self._paths.items()}
        return frame("driven", {"episode": self._episode, **paths})
