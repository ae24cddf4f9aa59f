"""What the referee hears and says."""

from vantage.service import Declaration

DECLARATION = Declaration(
    name="referee",
    inputs=("control", "hider/pose", "seeker/pose", "hider/command", "seeker/command"),
    outputs=("episode", "tick", "health/referee"),
    heeds=("simulator", "seeker", "planner", "predictor", "recorder"),
)
