"""Calibrating the overhead camera: pictures of the board make a lens, one picture of the corner tags makes its place."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from vantage.output import write_complete
from vantage.printable import counted
from vantage.setting_up.board_views import BoardView, BoardViews
from vantage.setting_up.pictures import Source
from vantage.setting_up.trouble import TableTrouble
from vantage.tracking.calibration import CalibrationFailed
from vantage.tracking.lens import FEWEST_VIEWS, Lens, LensResult, calibrate_lens

Tell = Callable[[BoardViews, int], None]
"""Called after each picture with the views kept and the number of pictures looked at."""

MOST_VIEWS: Final = 60
"""More views make the lens no better, and the fit slow."""
_LARGEST_FILE: Final = 100_000


def gather_views(
    source: Source, seconds: float, tell: Tell, views: BoardViews | None = None
) -> tuple[BoardViews, list[tuple[str, str]]]:
    """Look at pictures of the board until nothing is missing, the source ends, or a camera's time is over.

    Args:
        seconds: of a camera at most.
        views: to add to; default none yet.

    Returns:
        The views, and the names of pictures set aside with the reason (of a folder; a camera's and a video's are many).
    """
    views = views or BoardViews()
    refused: list[tuple[str, str]] = []
    named = not source.live and source.count is not None
    for looked, view in enumerate(source.views, 1):
        reason = views.offer(view.name, view.picture)
        if reason and named:
            refused.append((view.name, reason))
        tell(views, looked)
        if len(views.views) >= MOST_VIEWS or (source.live and (view.seconds > seconds or not views.missing())):
            break
    return views, refused


def measure_lens(views: BoardViews, looked: str) -> tuple[LensResult, list[BoardView]]:
    """Fit the lens. Returns the result, and the views in the order that its refusals count.

    Raises:
        TableTrouble: too few views, or the fit is bad; with what to show next.
    """
    missing = views.missing()
    if len(views.views) < FEWEST_VIEWS:
        found = len(views.views)
        raise TableTrouble(
            f"only {counted(found, 'different view')} of the board in {looked}, at least {FEWEST_VIEWS} are needed "
            f"({views.wanted} are good). Is it the board of `vantage table print`? Missing: {'; '.join(missing)}"
        )
    try:
        return calibrate_lens([view.picture for view in views.views], views.board), views.views
    except CalibrationFailed as error:
        hint = f". Missing in {looked}: {'; '.join(missing)}" if missing else ""
        raise TableTrouble(f"{error}{hint}") from error


def save_lens(lens: Lens, path: Path) -> None:
    """Write a lens as JSON, in one step."""
    write_complete(path, msgspec.json.format(msgspec.json.encode(lens), indent=2) + b"\n")


def load_lens(path: Path) -> Lens:
    """Read a lens.

    Raises:
        TableTrouble: no such file, or not a lens.
    """
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise TableTrouble(f"{path} is not the file of a lens: it is too large; see `vantage table calibrate lens`")
        return msgspec.json.decode(path.read_bytes(), type=Lens)
    except OSError as error:
        raise TableTrouble(
            f"cannot read the lens {path}: {error.strerror}; measure it first: `vantage table calibrate lens --to {path}`"
        ) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise TableTrouble(f"{path} is not the file of a lens: {error}; see `vantage table calibrate lens`") from error


def today() -> datetime.date:
    """Return the date that goes into a calibration."""
    return datetime.date.today()
