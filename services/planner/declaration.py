"""What the planner hears, says and asks."""

from vantage.service import Declaration

DECLARATION = Declaration(
    name="planner",
    inputs=("episode", "tick", "layout", "hider/pose", "hider/depth", "hider/color"),
    outputs=("hider/plan", "hider/command", "hider/view", "health/planner"),
    calls=("predictor",),
    heeds=("referee", "simulator|tracker", "predictor"),
)
