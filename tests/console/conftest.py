"""One deployment and one browser for all; each test has a page of its own, which must end without an error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.console.browser import ConsolePage, address_of, chromium
from tests.stack.table import Table

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if HERE in item.path.parents and "table" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.stack)


@pytest.fixture(scope="package")
def table() -> Iterator[Table]:
    """The simulation, its console included, up and healthy."""
    with Table() as running:
        assert running.started.returncode == 0, running.started.stdout + running.started.stderr
        yield running


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    with chromium() as running:
        yield running


@pytest.fixture
def open_page(table: Table, browser: Browser) -> Iterator[Callable[..., ConsolePage]]:
    """Open pages of the console; they are closed, and what they did wrong is told, after the test."""
    pages: list[ConsolePage] = []

    def open_one(**settings: object) -> ConsolePage:
        pages.append(ConsolePage(browser, address_of(table.folder), **settings))  # type: ignore[arg-type]
        return pages[-1]

    yield open_one
    pages[0].idle()
    for page in pages:
        page.close()


@pytest.fixture
def page(open_page: Callable[..., ConsolePage]) -> ConsolePage:
    return open_page()
