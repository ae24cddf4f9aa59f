"""A small SVG writer: shapes in metres or millimetres, text in pixels."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
import numpy.typing as npt

INK = "#111827"
FAINT = "#6b7280"


class Svg:
    """A drawing whose shapes are given in a length unit, y up.

    Args:
        left, low, right, top: what is shown.
        scale: px per unit.
        title: written above, and read out by screen readers.
    """

    HEAD = 40

    def __init__(self, left: float, low: float, right: float, top: float, scale: float, title: str) -> None:
        self._left, self._top, self._scale = left, top, scale
        self.width, self.height = round((right - left) * scale), round((top - low) * scale) + self.HEAD
        self._parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" width="{self.width}" '
            f'height="{self.height}" font-family="Helvetica, Arial, sans-serif" font-size="13" role="img" '
            f'aria-label="{escape(title)}">',
            f'<rect width="{self.width}" height="{self.height}" fill="#ffffff"/>',
            f'<text x="16" y="26" fill="{INK}" font-size="17" font-weight="bold">{escape(title)}</text>',
        ]

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Return where a point is, px."""
        return round((x - self._left) * self._scale, 2), round((self._top - y) * self._scale + self.HEAD, 2)

    def polygon(self, points: Sequence[tuple[float, float]], style: str) -> None:
        """Draw a closed shape."""
        listed = " ".join("{:g},{:g}".format(*self.place(*point)) for point in points)
        self._parts.append(f'<polygon points="{listed}" {style}/>')

    def rectangle(self, x: float, y: float, width: float, height: float, style: str) -> None:
        """Draw a rectangle from its lower left corner."""
        self.polygon(((x, y), (x + width, y), (x + width, y + height), (x, y + height)), style)

    def line(self, points: Sequence[tuple[float, float]], color: str = INK, width: float = 1.2, dashes: str = "") -> None:
        """Draw a line through points; `width` in px."""
        listed = " ".join("{:g},{:g}".format(*self.place(*point)) for point in points)
        dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
        self._parts.append(f'<polyline points="{listed}" fill="none" stroke="{color}" stroke-width="{width:g}"{dashed}/>')

    def circle(self, x: float, y: float, radius: float, style: str) -> None:
        """Draw a circle."""
        u, v = self.place(x, y)
        self._parts.append(f'<circle cx="{u:g}" cy="{v:g}" r="{round(radius * self._scale, 2):g}" {style}/>')

    def dot(self, x: float, y: float, color: str) -> None:
        """Draw a dot of 1.8 px."""
        u, v = self.place(x, y)
        self._parts.append(f'<circle cx="{u:g}" cy="{v:g}" r="1.8" fill="{color}"/>')

    def arrow(self, start: tuple[float, float], end: tuple[float, float], color: str = INK, width: float = 1.6) -> None:
        """Draw an arrow."""
        self.line((start, end), color, width)
        self._head(start, end, color)

    def measure(
        self, start: tuple[float, float], end: tuple[float, float], text: str, *, shift: tuple[float, float] = (0.0, -6.0)
    ) -> None:
        """Draw a dimension line with its text at the middle, shifted by px."""
        self.line((start, end), FAINT, 1.0)
        self._head(start, end, FAINT)
        self._head(end, start, FAINT)
        self.text((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, text, FAINT, shift=shift)

    def text(
        self,
        x: float,
        y: float,
        text: str,
        color: str = INK,
        *,
        anchor: str = "middle",
        size: int = 13,
        shift: tuple[float, float] = (0.0, 0.0),
        bold: bool = False,
    ) -> None:
        """Write a text; its base line is at the point, shifted by px (right, down)."""
        u, v = self.place(x, y)
        weight = ' font-weight="bold"' if bold else ""
        at = f'x="{u + shift[0]:g}" y="{v + shift[1]:g}"'
        self._parts.append(f'<text {at} fill="{color}" font-size="{size}" text-anchor="{anchor}"{weight}>{escape(text)}</text>')

    def cells(self, black: npt.NDArray[np.bool_], x: float, y: float, size: float, heading: float) -> None:
        """Draw a tag's cells, bool [n, n] True black, row 0 on top, with its centre at x, y and its own x along heading, rad."""
        count = len(black)
        cosine, sine = float(np.cos(heading)), float(np.sin(heading))
        commands = []
        for row, column in np.argwhere(black):
            corners = []
            for dx, dy in ((0, 0), (1, 0), (1, 1), (0, 1)):
                a = ((column + dx) / count - 0.5) * size
                b = (0.5 - (row + dy) / count) * size
                corners.append("{:g} {:g}".format(*self.place(x + cosine * a - sine * b, y + sine * a + cosine * b)))
            commands.append("M" + "L".join(corners) + "Z")
        self._parts.append(f'<path d="{"".join(commands)}" fill="#000000"/>')

    def _head(self, start: tuple[float, float], end: tuple[float, float], color: str) -> None:
        tail, tip = np.array(self.place(*start)), np.array(self.place(*end))
        along = (tip - tail) / max(float(np.linalg.norm(tip - tail)), 1e-9)
        across = np.array([-along[1], along[0]])
        points = (tip, tip - 8 * along + 3.5 * across, tip - 8 * along - 3.5 * across)
        listed = " ".join(f"{float(x):.1f},{float(y):.1f}" for x, y in points)
        self._parts.append(f'<polygon points="{listed}" fill="{color}"/>')

    def __str__(self) -> str:
        return "\n".join([*self._parts, "</svg>"]) + "\n"
