"""What the referee hears and says."""

from schemas.topics import COMMAND_LINE
from vantage.service import Declaration

WORLD = ("simulator", "tracker", "robot", "rehearsal")
"""Who embodies the robots, one or the other: what they say of themselves tells people why a game was aborted."""
OWNERS = COMMAND_LINE
"""Participants that may own games."""

# The console says by its health that a human could drive: games of the planner go on without it, so it is not heeded.
DECLARATION = Declaration(
    name="referee",
    inputs=(
        *("control", "layout", "hider/pose", "seeker/pose", "hider/command", "seeker/command"),
        *(f"health/{service}" for service in (*WORLD, "console")),
    ),
    outputs=("episode", "tick", "control", "health/referee"),
    heeds=("simulator|tracker", "simulator|robot|onboard", "seeker", "planner", "predictor", "recorder"),
    watches=(*OWNERS, *WORLD),
)
