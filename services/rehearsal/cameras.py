"""The cameras of the rehearsed table as a device: what was exposed is drawn in a thread, so that robots answer meanwhile."""

from __future__ import annotations

import queue
from collections.abc import Mapping

import msgspec
import numpy as np

from schemas import ROBOTS, Box, ColorImage, DepthImage, Intrinsics, Message
from services.rehearsal.core import CAMERAS, OVERHEAD, Exposure
from vantage.rehearsal.overhead_picture import OverheadScene
from vantage.rehearsal.rgbd_picture import RgbdCamera, render_rgbd
from vantage.tracking.rgbd_lens import Lens
from vantage.world.layout import boxes_array

WAIT = 0.2
Frames = list[tuple[str, Message]]


class Cameras:
    """See module, and `vantage.service.Device`: `write` takes an `Exposure`, `read` gives its messages with their keys.

    Args:
        scene: of the overhead camera.
        cameras: by robot.
        seed: of their noise.
    """

    name = CAMERAS
    newest_only = False

    def __init__(self, obstacles: tuple[Box, ...], scene: OverheadScene, cameras: Mapping[str, RgbdCamera], seed: int) -> None:
        self._obstacles, self._boxes = obstacles, boxes_array(obstacles)
        self._scene, self._cameras, self._seed = scene, cameras, seed
        (fx, _, cx), (_, fy, cy), _ = scene.camera.matrix.tolist()
        self._overhead_intrinsics = Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy, mount_height=float(scene.camera.centre[2]))
        self._exposed: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def open(self) -> None:
        """Nothing to open."""

    def write(self, data: bytes) -> None:
        self._exposed.put(data)

    def read(self) -> tuple[Frames, int] | None:
        try:
            frames = self.draw(self._exposed.get(timeout=WAIT))
        except queue.Empty:
            return None
        return frames, frames[0][1].stamp

    def close(self) -> None:
        """Nothing to close."""

    def draw(self, data: bytes) -> Frames:
        """Return the frames of an `Exposure`, encoded as MessagePack."""
        exposure = msgspec.msgpack.decode(data, type=Exposure)
        if exposure.camera == OVERHEAD:
            return self._draw_overhead(exposure)
        return self._draw_robots_view(exposure, exposure.camera.partition(" ")[0])

    def _draw_overhead(self, exposure: Exposure) -> Frames:
        poses, speeds = (np.array(rows) for rows in (exposure.poses, exposure.speeds))
        picture = self._scene.render(poses, self._obstacles, self._seed, exposure.number, speeds)
        height, width = picture.shape[:2]
        size = {"stamp": exposure.stamp, "width": width, "height": height}
        return [("overhead/color", ColorImage(**size, intrinsics=self._overhead_intrinsics, data=picture.tobytes()))]

    def _draw_robots_view(self, exposure: Exposure, robot: str) -> Frames:
        index = ROBOTS.index(robot)
        other = 1 - index
        camera, (x, y, _) = self._cameras[robot], exposure.poses[other]
        arguments = (self._boxes, exposure.poses[index], (x, y), other, self._seed, exposure.number, index)
        frames: Frames = []
        geometry = camera.geometry
        depth, color = render_rgbd(camera, *arguments)
        for part, kind, lens, array in (
            ("depth", DepthImage, geometry.depth, depth),
            ("color", ColorImage, geometry.color, color),
        ):
            size = {"stamp": exposure.stamp, "width": array.shape[1], "height": array.shape[0]}
            intrinsics = _intrinsics(lens, geometry.mount_height)
            frames.append((f"{robot}/camera/{part}", kind(**size, intrinsics=intrinsics, data=array.tobytes())))
        return frames


def _intrinsics(lens: Lens, mount_height: float) -> Intrinsics:
    return Intrinsics(fx=lens.fx, fy=lens.fy, cx=lens.cx, cy=lens.cy, mount_height=mount_height)
