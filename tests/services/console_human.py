"""Games that a human drives, on a table in one thread."""

from __future__ import annotations

from typing import Any

from schemas import Command
from services.console import requests
from tests.services.console_game import Table

STEPS = 12


def begin(table: Table, client: int = 1, **more: Any) -> None:
    table.ask(requests.Start(hider="human", **{"steps": STEPS, "seed": 5, **more}), client)


def commands(table: Table) -> list[Command]:
    return table.of("hider/command")


def step_of(table: Table) -> int:
    return max((command.step for command in commands(table)), default=-1)


def to_step(table: Table, step: int) -> None:
    table.run(lambda: step_of(table) >= step)


def to_end(table: Table, games: int = 1) -> None:
    table.run(lambda: sum(episode.phase in ("ended", "aborted") for episode in table.of("episode")) >= games)
    table.settle()
