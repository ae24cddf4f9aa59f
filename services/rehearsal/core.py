"""The rehearsed table as a pure core: bytes from the robots' lines come in, bytes and camera frames go out, by the clock.

Frames are drawn by a device (`services.rehearsal.cameras`): drawing one takes longer than a robot may take to answer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from schemas import ROBOTS
from services.rehearsal.declaration import DECLARATION
from services.rehearsal.world import World
from vantage.service import SECOND, TOO_SLOW, Captured, Publish, Received, Send, Write

WORLD_PERIOD = SECOND // 100
TRUTH_PERIOD = SECOND // 20

RATE_OVER = 5 * SECOND
"""ns over which the rate of the pictures from above is judged."""
LOWEST_RATE = 4.0
"""Pictures a second from above: with fewer, robots stop to be seen, and wait."""

FAULTS = "faults"
TRUTH = "truth"
CAMERAS = "cameras"
LINES = {f"{robot} line": robot for robot in ROBOTS}
"""Names of devices: what is unplugged; where the truth is written; what draws the frames; the robots' serial lines."""
OVERHEAD = "overhead camera"
PLUGS = (OVERHEAD, *(f"{robot} camera" for robot in ROBOTS), *LINES)
"""What can be unplugged."""


@dataclass(frozen=True)
class CameraSettings:
    """How often the cameras look."""

    overhead_rate: float = 20.0
    """frames a second of the overhead camera, at most"""
    camera_rate: float = 5.0
    """frames a second of each robot's camera, at most"""
    seed: int = 1
    """of the cameras' noise, of slip and of lost lines"""
    truth: bool = False
    """whether to hand out where the robots truly are"""


class Exposure(msgspec.Struct, frozen=True):
    """A frame to be drawn: of which camera, when (ns), its number, and how the robots (hider, seeker) stood and moved."""

    camera: str
    stamp: int
    number: int
    poses: list[tuple[float, float, float]]
    speeds: list[tuple[float, float, float]]


class RehearsalCore:
    """See module. Frames that are due while another is drawn are left out: the world never falls behind the clock."""

    declaration = DECLARATION

    def __init__(self, world: World, settings: CameraSettings | None = None) -> None:
        self._world = world
        self._settings = settings = settings or CameraSettings()
        self._periods = {OVERHEAD: int(SECOND / settings.overhead_rate)}
        self._periods |= {f"{robot} camera": int(SECOND / settings.camera_rate) for robot in ROBOTS}
        self._due: dict[str, int] = {}
        self._wake = 0
        self._truth_due = 0
        self._frame = 0
        self._drawing = False
        self._last_drawn = ""  # of which camera
        self._drawn: deque[int] = deque()  # when pictures from above were taken lately
        self._drawn_since: int | None = None  # since when their rate means something
        self._now = 0
        self._unplugged: frozenset[str] = frozenset()

    @property
    def trouble(self) -> str:
        """What was unplugged on purpose, and that the machine is too slow to draw what the cameras see."""
        unplugged = f"unplugged: {', '.join(sorted(self._unplugged))}" if self._unplugged else ""
        return "; ".join(text for text in (unplugged, self._slowness()) if text)

    def _slowness(self) -> str:
        if self._drawn_since is None or OVERHEAD in self._unplugged or self._now - self._drawn_since < RATE_OVER:
            return ""
        wanted = self._settings.overhead_rate
        rate = sum(self._now - drawn < RATE_OVER for drawn in self._drawn) * SECOND / RATE_OVER
        slow = rate < min(LOWEST_RATE, 0.5 * wanted)
        return f"{TOO_SLOW}: it draws {rate:.1f} of {wanted:g} pictures a second from above" if slow else ""

    def wake_at(self) -> int | None:
        return self._wake

    def step(self, received: Received, now: int) -> Sequence[Send]:
        self._now = now
        if isinstance(received, Captured):
            if received.device == FAULTS:
                if received.value is not None:
                    self._unplugged = received.value
                    self._drawn_since = now
            elif received.device == CAMERAS:
                self._drawing = False
                return () if received.value is None else [Publish(key, image) for key, image in received.value]
            elif received.value is not None:
                sends = self._advance(min(received.stamp, now))
                self._world.feed(LINES[received.device], received.value, now)
                return sends
            return ()
        if now < self._wake:
            return ()
        self._wake = now + WORLD_PERIOD
        return [*self._advance(now), *self._tell_truth(now), *self._look(now)]

    def _advance(self, now: int) -> list[Send]:
        said = self._world.advance(now)
        return [Write(line, said[robot]) for line, robot in LINES.items() if robot in said and line not in self._unplugged]

    def _tell_truth(self, now: int) -> Sequence[Send]:
        if not self._settings.truth or now < self._truth_due:
            return ()
        self._truth_due = now + TRUTH_PERIOD
        numbers = ",".join(f"{value:.6f}" for value in self._world.poses().ravel())
        return (Write(TRUTH, f"{now},{numbers}\n".encode()),)

    def _look(self, now: int) -> Sequence[Send]:
        """Have the frame drawn that is longest due, if one is and none is being drawn."""
        if not self._due:
            # The cameras run apart, as real ones do: a third of a period from each other.
            third = min(self._periods.values()) // 3
            self._due = {camera: now + place * third for place, camera in enumerate(self._periods)}
            self._drawn_since = now
        if self._drawing:
            return ()
        # Robots are driven by the view from above: where cores are short, every second frame is its.
        due = [name for name in self._due if self._due[name] <= now]
        if not due:
            return ()
        camera = min(due, key=lambda name: ((name == OVERHEAD) == (self._last_drawn == OVERHEAD), self._due[name]))
        late = (now - self._due[camera]) // self._periods[camera]
        self._due[camera] += (late + 1) * self._periods[camera]
        self._frame += 1
        if camera in self._unplugged:
            return ()
        self._last_drawn = camera
        self._drawing = True
        if camera == OVERHEAD:
            self._drawn.append(now)
            while now - self._drawn[0] > RATE_OVER:
                self._drawn.popleft()
        poses, speeds = self._world.poses().tolist(), self._world.speeds().tolist()
        return (Write(CAMERAS, msgspec.msgpack.encode(Exposure(camera, now, self._frame, poses, speeds))),)
