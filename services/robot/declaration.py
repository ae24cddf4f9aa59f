"""What the driver hears and says."""

from schemas import ROBOTS
from vantage.service import Declaration

DECLARATION = Declaration(
    name="robot",
    inputs=("control", "episode", "tick", "layout", *(f"{robot}/{part}" for part in ("command", "track") for robot in ROBOTS)),
    outputs=(*(f"{robot}/motion" for robot in ROBOTS), "health/robot"),
    heeds=("referee", "tracker"),
)
