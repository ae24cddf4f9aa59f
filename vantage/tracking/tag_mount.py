"""A tag on what carries it: where to expect it in a picture, and what a sighting of it says."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.table import Table
from vantage.tracking.tag_pose import MeasuredPose, measure_pose, mounted_corners
from vantage.tracking.tags import SMALLEST_FOR_HALF, FoundTag

Floats = npt.NDArray[np.float64]

_BORDERED = 1.25 * math.sqrt(2.0)
"""Diagonal of a tag with its white border over the side of its black square."""


class NotAsMounted(Exception):
    """A tag is not as large, as high or as flat as the table says; the text is for people."""


class TagMount:
    """One tag of the table.

    Args:
        name: of the tag, for people.
        tag: its id.
        size: side of the black square, m.
        height: of its plane above the floor, m.
        mounted: its corners on the axes of what carries it, float64 [4, 2] m.
        camera: that looks at it.

    Attributes:
        width: of the black square in the picture, px.
        diagonal: of the tag with its white border in the picture, px.
        half: whether it is wide enough to be sought in the picture halved.
    """

    def __init__(self, name: str, tag: int, size: float, height: float, mounted: Floats, camera: OverheadCamera) -> None:
        self.name, self.tag, self.height = name, tag, height
        self.width = size * camera.scale_at(height)
        self.diagonal = self.width * _BORDERED
        self.half = self.width >= SMALLEST_FOR_HALF
        self._camera, self._mounted, self._middle = camera, mounted, mounted.mean(axis=0)

    def place(self, pose: Floats) -> Floats:
        """Where the tag's centre appears when its carrier stands at pose float64 [3]: float64 [2] px."""
        cosine, sine = math.cos(pose[2]), math.sin(pose[2])
        x = pose[0] + cosine * self._middle[0] - sine * self._middle[1]
        y = pose[1] + sine * self._middle[0] + cosine * self._middle[1]
        return np.asarray(self._camera.project(np.array([[x, y, self.height]]))[0])

    def measure(self, found: FoundTag, sigma: float, scale_tolerance: float, residual_limit: float) -> MeasuredPose:
        """Return the pose of the carrier that a sighting gives; sigma of a corner in px.

        Raises:
            NotAsMounted: it looks larger or smaller by more than the tolerance (a share), or its corners stray from a square by
                more than the limit (m).
        """
        measured = measure_pose(self._camera, found.corners, self._mounted, self.height, sigma)
        off = measured.scale - 1.0
        if not np.isfinite(measured.pose).all():
            raise NotAsMounted(f"{self.name} does not lie flat")
        if abs(off) > scale_tolerance:
            word = "large" if off > 0 else "small"
            raise NotAsMounted(
                f"{self.name} looks {100 * abs(off):.0f} % too {word}: lifted, or its size or height in the table's file is wrong"
            )
        if measured.residual > residual_limit:
            raise NotAsMounted(f"{self.name} does not lie flat: its corners are {1000 * measured.residual:.0f} mm off a square")
        return measured


def robot_mounts(table: Table, camera: OverheadCamera) -> dict[str, TagMount]:
    """Return the tags of the robots, by robot."""
    return {
        robot: TagMount(
            f"{robot}'s tag {tag.id}",
            tag.id,
            tag.size,
            tag.height,
            mounted_corners(tag.size, tag.forward, tag.left, tag.heading),
            camera,
        )
        for robot, tag in table.robots.items()
    }


def box_mounts(table: Table, camera: OverheadCamera) -> list[TagMount]:
    """Return the tags of the boxes, in the order of the table."""
    return [
        TagMount(
            f"box tag {tag.id}",
            tag.id,
            tag.size,
            tag.height,
            mounted_corners(tag.size, tag.along, tag.across, tag.heading),
            camera,
        )
        for tag in table.obstacles
    ]


def corner_mounts(table: Table, camera: OverheadCamera) -> list[TagMount]:
    """Return the tags on the floor, each its own carrier, in the order of the table."""
    flat = mounted_corners(table.corner_size, 0.0, 0.0, 0.0)
    return [TagMount(f"corner tag {tag.id}", tag.id, table.corner_size, 0.0, flat, camera) for tag in table.corners]
