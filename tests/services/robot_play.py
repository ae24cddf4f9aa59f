"""Games that a driver plays with emulated robots."""

from __future__ import annotations

import math

from schemas import Box, Command, Control, Motion, Primitive
from tests.drive.emulated import EmulatedTable
from vantage.world.start import draw_start

SEED = 5


def at_start(seed: int = SEED, obstacles: tuple[Box, ...] = (), **changes: object) -> EmulatedTable:
    """A table whose robots stand (almost) at the starts of episode 1, and whose driver has reported so."""
    empty = EmulatedTable(obstacles=obstacles)
    starts = draw_start(empty.boxes, 1.2, 1.2, seed, 0.25, 0.45)
    places = [(x + 0.0005, y - 0.0004, math.radians(10.0 * heading + 0.5)) for x, y, heading in starts]
    table = EmulatedTable(places=places, obstacles=obstacles, **changes)  # type: ignore[arg-type]
    table.run(lambda: False, 0.3)
    table.set_up(seed=seed)
    assert table.run(lambda: len(table.motions) == 2, 10.0), table.core.trouble
    assert [motion.result for _, motion in table.motions] == ["completed"] * 2
    table.motions.clear()
    return table


def play(table: EmulatedTable, hider: Primitive, seeker: Primitive = "stay", step: int = 0) -> dict[str, Motion]:
    """Command one step; return both reports."""
    table.motions.clear()
    for robot, primitive in (("hider", hider), ("seeker", seeker)):
        table.say(f"{robot}/command", Command(stamp=table.now, episode=1, step=step, primitive=primitive))
    assert table.run(lambda: len(table.motions) == 2, 5.0), f"reported: {table.motions}"
    return dict(table.motions)


def ask_for_games(table: EmulatedTable, games: int = 1, request: str = "") -> None:
    table.say("control", Control(stamp=table.now, action="start", games=games, request=request))
