"""What the console hears, says and asks. It heeds nobody, so it works in every deployment, a replay among them."""

from schemas import ROBOTS, SERVICES
from vantage.service import Declaration

DECLARATION = Declaration(
    name="console",
    inputs=(
        *("episode", "tick", "layout", "hider/plan", "predictor/request", "control", "playback", "gap"),
        *(f"{robot}/{part}" for robot in ROBOTS for part in ("pose", "track", "depth", "color", "view")),
        *(f"health/{service}" for service in SERVICES),
    ),
    outputs=("control", "hider/command", "hider/view", "health/console"),
    calls=("predictor",),
    audience=True,
)
