"""What can be wrong with a replay, for people."""

from __future__ import annotations

from vantage.errors import UserError


class ReplayError(UserError):
    """What went wrong and what to do."""
