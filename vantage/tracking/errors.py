"""Errors of the tracking of a real table, for people: one line that says what is wrong and what to do."""

from __future__ import annotations

from vantage.errors import UserError


class TrackingError(UserError):
    """What is wrong with the table or its cameras, and what to do."""


class UnusableTable(TrackingError):
    """The description of the table cannot be used."""


class UnusableCalibration(TrackingError):
    """A calibration is missing, damaged, stale, bad, or of another camera mode."""


class CalibrationFailed(TrackingError):
    """The pictures given do not make a calibration."""
