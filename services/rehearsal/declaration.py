"""What the rehearsal says: what cameras would. A table hears nothing from the bus; the robots have their serial lines."""

from schemas import ROBOTS
from vantage.service import Declaration

DECLARATION = Declaration(
    name="rehearsal",
    outputs=(
        "overhead/color",
        *(f"{robot}/camera/{part}" for robot in ROBOTS for part in ("depth", "color")),
        "health/rehearsal",
    ),
)
"""Where things truly are is not said to anybody: the tracker has to find out."""
