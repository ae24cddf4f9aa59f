"""What the simulator hears and says."""

from schemas import ROBOTS
from vantage.service import Declaration

DECLARATION = Declaration(
    name="simulator",
    inputs=("episode", "tick", "hider/command", "seeker/command"),
    outputs=("layout", *(f"{robot}/{part}" for robot in ROBOTS for part in ("pose", "depth", "color")), "health/simulator"),
    heeds=("referee",),
)
