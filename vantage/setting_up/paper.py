"""Pages at true scale: everything is placed in millimetres from the lower left corner of the paper."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

Paper = Literal["a4", "letter"]

SIZES: Final[dict[str, tuple[float, float]]] = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}
"""Width and height of an upright page, mm."""

MARGIN: Final = 10.0
"""What a printer cannot reach at the edge of the paper, mm."""

_INCH = 25.4
_POINT = _INCH / 72.0


class Page:
    """One page; its `figure` is a matplotlib figure of the paper's exact size.

    Args:
        lying: landscape.
    """

    def __init__(self, paper: Paper, *, lying: bool = False) -> None:
        short, long = SIZES[paper]
        self.width, self.height = (long, short) if lying else (short, long)
        self.figure = Figure(figsize=(self.width / _INCH, self.height / _INCH))
        axes: Axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_xlim(0.0, self.width)
        axes.set_ylim(0.0, self.height)
        axes.set_axis_off()
        self._axes = axes

    def rectangles(self, rectangles: Iterable[tuple[float, float, float, float]], color: str = "black") -> None:
        """Fill rectangles (x, y, width, height in mm) as one shape, so that no seam shows where two of them touch."""
        corners: list[tuple[float, float]] = []
        codes: list[np.uint8] = []
        for x, y, width, height in rectangles:
            corners += [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]
            codes += [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
        if corners:
            self._axes.add_patch(PathPatch(Outline(corners, codes), facecolor=color, edgecolor="none", linewidth=0.0))

    def modules(self, black: npt.NDArray[np.bool_], x: float, y: float, size: float) -> None:
        """Draw the squares of a tag, bool [n, n], row 0 on top, with its lower left corner at x, y; `size` of the whole, mm."""
        count = black.shape[0]
        side = size / count
        self.rectangles((x + side * c, y + side * (count - 1 - r), side, side) for r, c in np.argwhere(black))

    def line(self, points: Sequence[tuple[float, float]], *, width: float = 0.2, color: str = "black") -> None:
        """Draw a line through points, mm; `width` in mm."""
        x, y = zip(*points, strict=True)
        self._axes.plot(x, y, color=color, linewidth=width / _POINT, solid_capstyle="butt")

    def arrow(self, x: float, y: float, length: float) -> None:
        """Draw an arrow to the right that begins at x, y, mm."""
        tip = x + length
        self.line([(x, y), (tip - 2.0, y)], width=0.6)
        outline = Outline([(tip, y), (tip - 3.5, y + 1.5), (tip - 3.5, y - 1.5), (tip, y)], closed=True)
        self._axes.add_patch(PathPatch(outline, facecolor="black", edgecolor="none", linewidth=0.0))

    def text(
        self, x: float, y: float, text: str, *, size: float = 3.2, align: Literal["left", "center", "right"] = "left"
    ) -> None:
        """Write text whose first line's base stands at y; `size` of the letters in mm."""
        self._axes.text(x, y, text, fontsize=size / _POINT, ha=align, va="baseline", linespacing=1.3)


def pdf(title: str, pages: Sequence[Page]) -> bytes:
    """Return pages as one PDF, with nothing in it that differs from run to run."""
    content = io.BytesIO()
    with PdfPages(content, metadata={"Title": title, "Creator": "vantage table print", "CreationDate": None}) as document:
        for page in pages:
            document.savefig(page.figure)
    return content.getvalue()
