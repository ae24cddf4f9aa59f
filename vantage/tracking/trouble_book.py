"""What is wrong on the table, for people: kept until it has not been noted for a while."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import numpy.typing as npt

from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.tag_mount import TagMount
from vantage.tracking.tags import FoundTag


class TroubleBook:
    """Troubles by what they are about; the newest text of each counts.

    Args:
        lasting: s for which a trouble stands after it was last noted.
    """

    def __init__(self, lasting: float) -> None:
        self._lasting = round(lasting * 1e9)
        self._noted: dict[tuple[str, str], tuple[int, str]] = {}

    def note(self, kind: str, name: str, text: str, stamp: int) -> None:
        """Note a trouble of a kind with what is named, seen at stamp (ns)."""
        self._noted[kind, name] = (stamp, text)

    def standing(self, stamp: int) -> list[str]:
        """Return the texts of what was noted not long before stamp (ns)."""
        self._noted = {key: noted for key, noted in self._noted.items() if 0 <= stamp - noted[0] <= self._lasting}
        return [text for _, text in self._noted.values()]


def twins_text(mount: TagMount, centres: list[npt.NDArray[np.float64]], camera: OverheadCamera) -> str:
    """Say where tags of one id are seen; centres float64 [2] px each."""
    points = [camera.on_plane(centre[None], mount.height)[0][0] for centre in centres]
    places = " and ".join(f"({x:.2f}, {y:.2f})" for x, y in sorted(tuple(point.tolist()) for point in points))
    return f"{mount.name} is seen twice, at {places} m: take one away"


def elsewhere(found: list[FoundTag], place: npt.NDArray[np.float64], mount: TagMount) -> list[FoundTag]:
    """Return those of some tags that are not the one at a place, float64 [2] px."""
    return [tag for tag in found if np.linalg.norm(tag.centre - place) > mount.width / 2]


def clock(stamp: int) -> str:
    """Return a stamp (ns since the Unix epoch) as the time of day."""
    try:
        return datetime.fromtimestamp(stamp / 1e9).strftime("%H:%M:%S")
    except (OverflowError, OSError, ValueError):
        return f"{stamp * 1e-9:.1f} s"
