"""The rehearsed table as a pure core: bytes from the robots' lines come in, bytes and camera frames go out, by the clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from schemas import ROBOTS, Box, ColorImage, DepthImage, Intrinsics
from services.rehearsal.declaration import DECLARATION
from services.rehearsal.world import World
from vantage.rehearsal.overhead_picture import OverheadScene
from vantage.rehearsal.rgbd_picture import RgbdCamera, render_rgbd
from vantage.service import SECOND, Captured, Publish, Received, Send, Write
from vantage.tracking.rgbd_lens import Lens

WORLD_PERIOD = SECOND // 100
TRUTH_PERIOD = SECOND // 20

FAULTS = "faults"
TRUTH = "truth"
LINES = {f"{robot} line": robot for robot in ROBOTS}
"""Names of devices: what is unplugged; where the truth is written; the robots' serial lines."""
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


class RehearsalCore:
    """See module. Frames that are due while another is drawn are left out: the world never falls behind the clock.

    Args:
        scene: of the overhead camera.
        cameras: by robot.
    """

    declaration = DECLARATION

    def __init__(
        self,
        world: World,
        obstacles: tuple[Box, ...],
        scene: OverheadScene,
        cameras: Mapping[str, RgbdCamera],
        settings: CameraSettings | None = None,
    ) -> None:
        self._world, self._obstacles, self._scene, self._cameras = world, obstacles, scene, cameras
        self._settings = settings = settings or CameraSettings()
        (fx, _, cx), (_, fy, cy), _ = scene.camera.matrix.tolist()
        self._overhead_intrinsics = Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy, mount_height=float(scene.camera.centre[2]))
        self._periods = {OVERHEAD: int(SECOND / settings.overhead_rate)}
        self._periods |= {f"{robot} camera": int(SECOND / settings.camera_rate) for robot in ROBOTS}
        self._due: dict[str, int] = {}
        self._wake = 0
        self._truth_due = 0
        self._frame = 0
        self._unplugged: frozenset[str] = frozenset()

    @property
    def trouble(self) -> str:
        """What was unplugged on purpose."""
        return f"unplugged: {', '.join(sorted(self._unplugged))}" if self._unplugged else ""

    def wake_at(self) -> int | None:
        return self._wake

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Captured):
            if received.device == FAULTS:
                if received.value is not None:
                    self._unplugged = received.value
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
        """Take the frame that is longest due, if one is: one at a time, so that the robots' lines are served in between."""
        if not self._due:
            # The cameras run apart, as real ones do: a third of a period from each other.
            third = min(self._periods.values()) // 3
            self._due = {camera: now + place * third for place, camera in enumerate(self._periods)}
        camera = min(self._due, key=lambda name: self._due[name])
        if now < self._due[camera]:
            return ()
        late = (now - self._due[camera]) // self._periods[camera]
        self._due[camera] += (late + 1) * self._periods[camera]
        self._frame += 1
        if camera in self._unplugged:
            return ()
        return self._look_down(now) if camera == OVERHEAD else self._look_ahead(camera.partition(" ")[0], now)

    def _look_down(self, now: int) -> Sequence[Send]:
        world = self._world
        picture = self._scene.render(world.poses(), self._obstacles, self._settings.seed, self._frame, world.speeds())
        height, width = picture.shape[:2]
        image = ColorImage(stamp=now, width=width, height=height, intrinsics=self._overhead_intrinsics, data=picture.tobytes())
        return (Publish("overhead/color", image),)

    def _look_ahead(self, robot: str, now: int) -> Sequence[Send]:
        index = ROBOTS.index(robot)
        other = 1 - index
        poses = self._world.poses().tolist()
        depth, color = render_rgbd(
            self._cameras[robot],
            self._world.boxes,
            tuple(poses[index]),
            (poses[other][0], poses[other][1]),
            other,
            self._settings.seed,
            self._frame,
            index,
        )
        geometry = self._cameras[robot].geometry
        height = geometry.mount_height
        return (
            Publish(
                f"{robot}/camera/depth",
                DepthImage(
                    stamp=now,
                    width=depth.shape[1],
                    height=depth.shape[0],
                    intrinsics=_intrinsics(geometry.depth, height),
                    data=depth.tobytes(),
                ),
            ),
            Publish(
                f"{robot}/camera/color",
                ColorImage(
                    stamp=now,
                    width=color.shape[1],
                    height=color.shape[0],
                    intrinsics=_intrinsics(geometry.color, height),
                    data=color.tobytes(),
                ),
            ),
        )


def _intrinsics(lens: Lens, mount_height: float) -> Intrinsics:
    return Intrinsics(fx=lens.fx, fy=lens.fy, cx=lens.cx, cy=lens.cy, mount_height=mount_height)
