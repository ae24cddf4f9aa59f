"""What the recorder hears and says."""

from vantage.service import Declaration

DECLARATION = Declaration(name="recorder", inputs=("**",), outputs=("gap", "health/recorder"), raw=True)
