"""What the referee hears and says."""

from vantage.service import Declaration

WORLD = ("simulator", "tracker", "robot")
"""Who embodies the robots, one or the other: what they say of themselves tells people why a game was aborted."""

DECLARATION = Declaration(
    name="referee",
    inputs=(
        *("control", "layout", "hider/pose", "seeker/pose", "hider/command", "seeker/command"),
        *(f"health/{service}" for service in WORLD),
    ),
    outputs=("episode", "tick", "health/referee"),
    heeds=("simulator|tracker", "simulator|robot|onboard", "seeker", "planner", "predictor", "recorder"),
)
