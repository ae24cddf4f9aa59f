"""Pictures of the console for docs/: `python -m tests.console.screenshots`, from games that are really played."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro
from PIL import Image
from rich.console import Console

from tests.console.browser import ConsolePage, address_of, chromium
from tests.stack.table import Table
from vantage.output import complete

SIZES = ((1440, 900), (1920, 1080))
THEMES: tuple[Literal["dark", "light"], ...] = ("dark", "light")
LATE_STEP = 72
"""Of a game to watch: most predicted views then have the true one beside them."""


@dataclass(frozen=True)
class Settings:
    """Start a simulation, watch and play games in a real browser, and save what the page shows.

    Examples:
        python -m tests.console.screenshots
        python -m tests.console.screenshots --to /tmp/pictures --seed 7
    """

    to: Path = Path(__file__).parents[2] / "docs" / "console"
    """Where the pictures go."""
    seed: int = 1
    """Seed of the game that is watched."""


def save(picture: bytes, path: Path) -> None:
    """Write a PNG in true colours: a palette would change those of the robots."""
    with complete(path) as partial:
        Image.open(io.BytesIO(picture)).convert("RGB").save(partial, "png", optimize=True)


def looks(page: ConsolePage) -> Iterator[str]:
    """Give the page each size and theme in turn; yields the end of the picture's name."""
    for width, height in SIZES:
        page.page.set_viewport_size({"width": width, "height": height})
        for theme in THEMES:
            page.page.emulate_media(color_scheme=theme)
            page.be_painted()
            page.until(f"document.documentElement.dataset.theme === '{theme}'")
            yield f"{width}x{height}-{theme}.png"


def main(settings: Settings) -> None:
    console = Console(highlight=False)
    settings.to.mkdir(parents=True, exist_ok=True)

    def photograph(page: ConsolePage, name: str) -> None:
        for end in looks(page):
            save(page.page.screenshot(), settings.to / f"{name}-{end}")
        console.print(f"{name}: done")

    with Table() as table, chromium() as browser:
        page = ConsolePage(browser, address_of(table.folder))
        photograph(page, "first-visit")
        page.page.get_by_label("seed").fill(str(settings.seed))
        page.watch_a_game(f"vantage.state.frames.tick?.header.step >= {LATE_STEP}", held=False)
        photograph(page, "live")
        page.idle()
        page.press("h")
        photograph(page, "rules")
        page.press("Escape")
        page.begin_human_game(steps=100, period=1.0, seed=5, key="ArrowLeft")  # slow: the pictures are of one moment
        page.press("i")
        seen = "vantage.state.frames['hider/view']?.header.other_x != null"
        page.until(f"{seen} && vantage.state.frames.tick?.header.step > 1")
        page.page.keyboard.up("ArrowLeft")
        photograph(page, "play")
        page.idle()
        page.close()


if __name__ == "__main__":
    main(tyro.cli(Settings))
