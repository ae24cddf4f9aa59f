"""How figures look: the one place of their colours, fonts and size on disk. State images keep the palette of perception."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray
from PIL import Image

from schemas import Box, Robot
from vantage.output import complete
from vantage.perception.palette import BOUNDARY, DANGER, FREE, INVISIBLE, PALETTE
from vantage.world.arena import ARENA_SIZE, ROBOT_COLORS, ROBOT_RADIUS

matplotlib.use("Agg")

WIDTH = 14.4
"""Inches a figure is wide: 1440 pixels, a laptop's screen."""
DPI = 100

ROBOTS: dict[Robot, tuple[float, ...]] = {robot: tuple(part / 255 for part in color) for robot, color in ROBOT_COLORS.items()}
VIEW_LEGEND: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("seen free floor", tuple(PALETTE[FREE] / 255)),
    ("not seen", tuple(PALETTE[INVISIBLE] / 255)),
    ("boundary", tuple(PALETTE[BOUNDARY] / 255)),
    *ROBOTS.items(),
)
"""What the colours of state images stand for in pictures for people, whoever looks."""
DANGER_MAP = LinearSegmentedColormap.from_list("danger", DANGER / 255)
"""Blue is a low danger, red a high one: the same colours as on the console's page and in exports."""
BOX = "0.25"
QUIET = "0.35"  # captions

METHODS: dict[str, str] = {  # Okabe and Ito's colours, which the colour-blind tell apart
    "vpt-tob": "#0072B2",
    "whole-image": "#56B4E9",
    "hazard": "#D55E00",
    "hazard-attention": "#8B2C00",
    "caught-head": "#E69F00",
    "self-perspective": "#009E73",
    "vector-action": "#CC79A7",
    "coordinate-path": "#7A6A00",
    "coordinate-end": "#B8A92D",
}
TITLES: dict[str, str] = {
    "vpt-tob": "VPT-TOB + VPN",
    "whole-image": "VPT-TOB, whole image, + VPN",
    "hazard": "hazard",
    "hazard-attention": "attention hazard",
    "caught-head": "caught head of VPT-TOB",
    "self-perspective": "self-perspective + VPN",
    "vector-action": "vector-action + VPN",
    "coordinate-path": "coordinate-value, path",
    "coordinate-end": "coordinate-value, end",
}
OTHER = "0.45"  # what needs no network


def title_of(method: str) -> str:
    """Return what a method is called in figures and tables."""
    return TITLES.get(method, method)


def color_of(method: str) -> str:
    """Return a method's colour."""
    return METHODS.get(method, OTHER)


def new_figure(height: float, title: str, caption: str = "", width: float = WIDTH, views: bool = False) -> Figure:
    """Return an empty figure, `width` x `height` inches, with a title above and a caption below.

    Args:
        views: state images will be in it: say what their colours stand for.
    """
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    figure.text(0.01, 1 - 0.12 / height, title, fontsize=16, fontweight="bold", va="top")
    figure.text(0.01, (0.36 if views else 0.10) / height, caption, fontsize=11, color=QUIET, va="bottom", wrap=True)
    if views:
        view_legend(figure, 0.01 * width, 0.10)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG in true colours: a palette of fewer would change those that the legend names."""
    raw = io.BytesIO()
    figure.savefig(raw, format="png")
    with complete(path) as partial:
        Image.open(raw).convert("RGB").save(partial, "png", optimize=True)


def view_legend(figure: Figure, left: float, bottom: float) -> None:
    """Draw what the colours of state images stand for in one line: inches from the figure's lower left corner."""
    width, height = figure.get_size_inches()
    for name, color in VIEW_LEGEND:
        place = (left / width, bottom / height)
        swatch = Rectangle(place, 0.15 / width, 0.15 / height, facecolor=color, edgecolor=QUIET, transform=figure.transFigure)
        figure.add_artist(swatch)
        figure.text((left + 0.21) / width, place[1], name, fontsize=11, color=QUIET, va="bottom")
        left += 0.45 + 0.085 * len(name)


def show_image(axes: Axes, image: NDArray[np.uint8], title: str = "", below: str = "") -> None:
    """Show a picture [H, W, 3] or [H, W] with a thin frame and no ticks."""
    axes.imshow(image, interpolation="nearest", cmap="gray", vmin=0, vmax=255)
    axes.set_xticks([])
    axes.set_yticks([])
    if title:
        axes.set_title(title, fontsize=11)
    if below:
        axes.set_xlabel(below, fontsize=11)


def arena(axes: Axes, boxes: tuple[Box, ...], ticks: bool = True) -> None:
    """Make axes the arena from above, in m, with its boxes."""
    axes.set_xlim(0, ARENA_SIZE)
    axes.set_ylim(0, ARENA_SIZE)
    axes.set_aspect("equal")
    places = np.arange(0.0, 1.21, 0.4) if ticks else ()
    axes.set_xticks(places)
    axes.set_yticks(places)
    for box in boxes:
        corner = (-box.half_width, -box.half_depth)
        place = Affine2D().rotate(box.heading).translate(box.x, box.y) + axes.transData
        axes.add_patch(Rectangle(corner, 2 * box.half_width, 2 * box.half_depth, color=BOX, zorder=3, transform=place))


def robot(axes: Axes, who: Robot, x: float, y: float, heading: float) -> None:
    """Draw a robot's disc and where it looks: m, rad."""
    axes.add_patch(Circle((x, y), ROBOT_RADIUS, facecolor=ROBOTS[who], edgecolor="black", linewidth=0.8, zorder=6))
    tip = (x + ROBOT_RADIUS * np.cos(heading), y + ROBOT_RADIUS * np.sin(heading))
    axes.plot([x, tip[0]], [y, tip[1]], color="black", linewidth=1.2, zorder=7)
