"""What a lab prints: a card for every tag of the table, the ChArUco board, and a ruler that checks the printer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2

from vantage.output import write_complete
from vantage.setting_up.former import keep_former
from vantage.setting_up.paper import MARGIN, Page, Paper, pdf
from vantage.setting_up.trouble import TableTrouble
from vantage.tracking.lens import BoardDescription, charuco_board
from vantage.tracking.table import TAG_CELLS, Table
from vantage.tracking.tags import tag_cells

_MM = 1000.0
_STRIP = 12.0
"""Height of the strip below a tag that holds its text and arrow, mm."""
_GAP = 10.0
"""Between two cards, mm: room for both their cut marks."""
_BOARD_MARGIN = 3.0
"""The outermost squares may lose their edge to the printer: their markers stay whole. mm"""
_CUT = 4.0
"""Length of a cut mark, which lies outside of the card, mm."""

RULER = 100.0
"""mm in both directions on the page that checks the printer."""


@dataclass(frozen=True, slots=True)
class Card:
    """One tag to be cut out.

    Attributes:
        size: side of the black square, mm.
        purpose: what it is for, one line.
        placing: where it goes and what its arrow points to, one line.
    """

    family: str
    id: int
    size: float
    purpose: str
    placing: str

    @property
    def quiet(self) -> float:
        """Width of the white border, mm: one square of the tag, which the detector needs."""
        return self.size / TAG_CELLS

    @property
    def width(self) -> float:
        return self.size + 2 * self.quiet

    @property
    def height(self) -> float:
        return self.width + _STRIP


def robot_cards(table: Table) -> list[Card]:
    """Return the cards that go on top of the robots."""
    return [
        Card(
            table.family,
            tag.id,
            tag.size * _MM,
            f"{table.family} {tag.id}: the {robot}, {tag.size * _MM:g} mm",
            f"{tag.height * _MM:g} mm above floor, {_beside(tag.forward, tag.left)}; arrow: {_turned(tag.heading, 'forward')}",
        )
        for robot, tag in table.robots.items()
    ]


def obstacle_cards(table: Table) -> list[Card]:
    """Return the cards that go on top of the obstacles."""
    return [
        Card(
            table.family,
            tag.id,
            tag.size * _MM,
            f"{table.family} {tag.id}: box {2 * tag.half_width * _MM:g} x {2 * tag.half_depth * _MM:g} x {tag.height * _MM:g} mm",
            f"on top, {_beside(tag.along, tag.across)}; arrow: "
            + _turned(tag.heading, f"its {2 * tag.half_width * _MM:g} mm side"),
        )
        for tag in table.obstacles
    ]


def corner_cards(table: Table) -> list[Card]:
    """Return the cards that lie on the floor around the arena."""
    return [
        Card(
            table.family,
            tag.id,
            table.corner_size * _MM,
            f"{table.family} {tag.id}: corner tag, {table.corner_size * _MM:g} mm, on the floor",
            f"centre at x = {tag.x * _MM:g} mm, y = {tag.y * _MM:g} mm; arrow: {_turned(tag.heading, 'along x')}",
        )
        for tag in table.corners
    ]


def card_pages(cards: Sequence[Card], paper: Paper) -> list[Page]:
    """Return pages with the cards, as many on a page as fit.

    Raises:
        TableTrouble: a card is larger than the paper.
    """
    pages: list[Page] = []
    left, top, row = math.inf, 0.0, 0.0
    for card in cards:
        upright = Page(paper)
        if card.width > upright.width - 2 * MARGIN or card.height > upright.height - 2 * MARGIN:
            raise TableTrouble(
                f"tag {card.id} of {card.size:g} mm does not fit on {paper}: make it smaller in the table's file, "
                f"or have it printed elsewhere with a white border of {card.quiet:g} mm"
            )
        if pages and left + card.width > pages[-1].width - MARGIN:
            left, top, row = MARGIN, top - row - _GAP, 0.0
        if not pages or top - card.height < MARGIN:
            pages.append(upright)
            left, top, row = MARGIN, upright.height - MARGIN, 0.0
        _draw_card(pages[-1], card, left, top - card.height)
        left += card.width + _GAP
        row = max(row, card.height)
    return pages


def board_page(board: BoardDescription, paper: Paper) -> Page:
    """Return the ChArUco board that the lens is measured with, in the middle of a lying page.

    Raises:
        TableTrouble: it does not fit on the paper.
    """
    page = Page(paper, lying=True)
    square, marker = board.square * _MM, board.marker * _MM
    width, height = board.columns * square, board.rows * square
    left, low = (page.width - width) / 2, (page.height - height) / 2 + 3.0
    if left < _BOARD_MARGIN or (page.height - height) / 2 < MARGIN:
        raise TableTrouble(f"the board of {width:g} x {height:g} mm does not fit on {paper}")
    chess = charuco_board(board)
    page.rectangles(
        (left + square * column, low + square * (board.rows - 1 - row), square, square)
        for row in range(board.rows)
        for column in range(board.columns)
        if (row + column) % 2 == 0
    )
    dictionary = chess.getDictionary()
    side = dictionary.markerSize + 2
    for number, corners in zip(chess.getIds().ravel(), chess.getObjPoints(), strict=True):
        # OpenCV's board: m, x right, y down from the upper left corner.
        x, bottom = corners[:, 0].min() * _MM, corners[:, 1].max() * _MM
        picture = cv2.aruco.generateImageMarker(dictionary, int(number), side, borderBits=1)
        page.modules(picture < 128, left + x, low + height - bottom, marker)
    page.text(
        page.width / 2,
        low - 8.0,
        f"ChArUco board, {board.columns} x {board.rows} squares of {square:g} mm. Glue it flat on a board, glass or aluminium.",
        size=2.8,
        align="center",
    )
    return page


def ruler_page(paper: Paper) -> Page:
    """Return the page that tells whether the printer was true: 100 mm in both directions."""
    page = Page(paper)
    x, y = 40.0, 110.0
    page.text(x, page.height - 30.0, "Was this printed at true scale?", size=6.0)
    page.text(
        x,
        page.height - 44.0,
        f"Lay a steel ruler along both lines. Each must be {RULER:g} mm long, to half a millimetre.\n"
        'If not: print again at 100 % ("actual size"), without "fit to page", and measure again.\n'
        "All sheets must come from the same printer with the same settings as this one.",
        size=3.6,
    )
    # Apart from each other, so that no tick lengthens a line.
    ends = [(x, y - 15.0, 1.0, 0.0), (x, y, 0.0, 1.0)]
    for start_x, start_y, right, up in ends:
        page.line([(start_x, start_y), (start_x + RULER * right, start_y + RULER * up)], width=0.2)
        for tick in range(int(RULER) + 1):
            length = 8.0 if tick % 10 == 0 else 5.0 if tick % 5 == 0 else 3.0
            at = (start_x + tick * right, start_y + tick * up)
            page.line([at, (at[0] - length * up, at[1] - length * right)], width=0.1)
            if tick % 10 == 0:
                label = (at[0], at[1] - 12.0) if right else (at[0] - 10.0, at[1] - 1.0)
                page.text(*label, f"{tick}", align="center" if right else "right")
    # A square of exactly the ruler's length for callipers or a set square.
    page.rectangles([(x + 5.0, y + 5.0, 50.0, 50.0)])
    page.text(x + 60.0, y + 28.0, "This square is 50 mm\nwide and high.")
    return page


def write_sheets(folder: Path, table: Table, paper: Paper) -> list[tuple[Path, int, str]]:
    """Write every sheet of a table into a folder, made if missing. Returns each file with its number of pages, and what is kept
    of a former one (`keep_former`).

    Raises:
        TableTrouble: something of the table cannot be printed.
    """
    documents = {
        "ruler": ("a ruler that checks the printer", [ruler_page(paper)]),
        "robots": ("tags of the robots", card_pages(robot_cards(table), paper)),
        "corners": ("tags around the arena", card_pages(corner_cards(table), paper)),
        "obstacles": ("tags of the boxes", card_pages(obstacle_cards(table), paper)),
        "board": ("ChArUco board for the lens", [board_page(BoardDescription(), paper)]),
    }
    written = []
    for name, (title, pages) in documents.items():
        if pages:
            content, file = pdf(f"Vantage: {title}", pages), folder / f"{name}.pdf"
            kept = keep_former(file, content)
            write_complete(file, content)
            written.append((file, len(pages), kept))
    return written


def _draw_card(page: Page, card: Card, x: float, y: float) -> None:
    """Draw a card with its lower left corner at x, y, mm."""
    quiet, width, height = card.quiet, card.width, card.height
    tag_x, tag_y = x + quiet, y + _STRIP + quiet
    page.modules(tag_cells(card.id)[1:-1, 1:-1] < 128, tag_x, tag_y, card.size)
    for corner_x, outward_x in ((x, -1.0), (x + width, 1.0)):
        for corner_y, outward_y in ((y, -1.0), (y + height, 1.0)):
            page.line([(corner_x, corner_y), (corner_x + _CUT * outward_x, corner_y)], width=0.1)
            page.line([(corner_x, corner_y), (corner_x, corner_y + _CUT * outward_y)], width=0.1)
    # Marks of the tag's centre lines at the edge of the white border, to place it by.
    middle_x, middle_y = tag_x + card.size / 2, tag_y + card.size / 2
    mark = 0.3 * quiet
    for line in (
        [(middle_x, y + height), (middle_x, y + height - mark)],
        [(middle_x, y + _STRIP), (middle_x, y + _STRIP + mark)],
        [(x, middle_y), (x + mark, middle_y)],
        [(x + width, middle_y), (x + width - mark, middle_y)],
    ):
        page.line(line, width=0.15)
    page.arrow(middle_x - 0.35 * card.size, y + _STRIP - 2.0, 0.7 * card.size)
    letters = min(2.6, card.width / 30.0)
    page.text(middle_x, y + _STRIP - 6.5, card.purpose, size=letters, align="center")
    page.text(middle_x, y + _STRIP - 10.5, card.placing, size=min(letters, 1.75 * card.width / len(card.placing)), align="center")


def _beside(one: float, other: float) -> str:
    if one == 0.0 and other == 0.0:
        return "centred"
    return f"centre {one * _MM:+g} mm along the arrow's direction, {other * _MM:+g} mm to its left"


def _turned(heading: float, direction: str) -> str:
    degrees = round(math.degrees(heading), 3)
    return direction if degrees == 0.0 else f"turned {degrees:+g}° (counter-clockwise) from {direction}"
