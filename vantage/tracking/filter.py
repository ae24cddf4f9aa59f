"""A robot's pose over time: constant velocity, which says when it predicts rather than sees."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrackState:
    """Where a robot is.

    Attributes:
        x: centre, m, arena frame.
        y: centre, m, arena frame.
        heading: rad, counter-clockwise from +x, within pi of 0.
        speed_x: m/s.
        speed_y: m/s.
        turn_rate: rad/s.
        covariance: xx, xy, xh, yy, yh, hh in m and rad.
        seen: False: predicted, the tag was not seen in this picture.
        stamp: of the picture, ns.
    """

    x: float
    y: float
    heading: float
    speed_x: float
    speed_y: float
    turn_rate: float
    covariance: tuple[float, float, float, float, float, float]
    seen: bool
    stamp: int
