"""Everything here starts real processes, so it is marked `stack` and runs after the other tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.stack.table import Table

HERE = Path(__file__).parent
PAUSE = 0.5
"""Seconds between two games."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.stack)


@pytest.fixture(scope="session")
def table() -> Iterator[Table]:
    """A whole deployment, up and healthy, in a private folder of its own: for all tests that leave it so."""
    with Table("simulation", "--with", f"referee=--pause {PAUSE}") as running:
        yield running
