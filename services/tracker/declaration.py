"""What the tracker hears and says."""

from schemas import ROBOTS
from vantage.service import Declaration

DECLARATION = Declaration(
    name="tracker",
    inputs=(
        *("episode", "tick", "overhead/color"),
        *(f"{robot}/{part}" for robot in ROBOTS for part in ("motion", "camera/depth", "camera/color")),
    ),
    outputs=(
        *("layout", "health/tracker"),
        *(f"{robot}/{part}" for robot in ROBOTS for part in ("pose", "depth", "color", "track")),
    ),
    heeds=("referee",),
)
