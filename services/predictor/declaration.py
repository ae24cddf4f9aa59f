"""What the predictor hears and says."""

from vantage.service import Declaration

DECLARATION = Declaration(
    name="predictor",
    outputs=("predictor/request", "predictor/reply", "health/predictor"),
    serves=("predictor",),
)
