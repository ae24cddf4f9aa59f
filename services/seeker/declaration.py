"""What the seeker hears and says."""

from vantage.service import Declaration

DECLARATION = Declaration(
    name="seeker",
    inputs=("episode", "tick", "seeker/pose", "seeker/depth", "seeker/color"),
    outputs=("seeker/command", "seeker/view", "health/seeker"),
    heeds=("referee",),
)
