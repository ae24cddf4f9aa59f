"""Whoever embodies the robots takes no notice of a pause: the running game is said again, and nothing moves until it goes on."""

from __future__ import annotations

from schemas import ROBOTS, Episode, Rules
from tests.contract.tables import LAYOUT_SEED, TableOnTest


def say_paused(table: TableOnTest, paused: bool) -> None:
    rules = Rules(layout="lab")
    episode = Episode(stamp=table.clock(), episode=1, seed=LAYOUT_SEED, phase="running", rules=rules, paused=paused)
    table.publish("referee", "episode", episode)


def test_a_game_goes_on_after_a_pause_as_if_there_had_been_none(table: TableOnTest) -> None:
    table.begin(1)
    table.move(1, 0, "left", "right")
    say_paused(table, True)
    before = len(table.messages("layout", 1))
    table.run(lambda: False, 3.0)
    assert len(table.messages("layout", 1)) == before  # nobody took it for another set-up
    assert not table.has_step(1, 2)
    assert not [trouble for trouble in table.troubles() if "s old" in trouble]
    say_paused(table, False)
    table.move(1, 1, "right", "left")
    for robot in ROBOTS:
        assert [pose.step for pose in table.messages(f"{robot}/pose", 1)] == [0, 1, 2]
    assert all(runtime.health_report("ok").failed == 0 for runtime in table.runtimes)


def test_a_step_that_is_under_way_is_finished_in_a_pause(table: TableOnTest) -> None:
    table.begin(1)
    table.command(1, 0, hider="left", seeker="left")
    say_paused(table, True)
    assert table.run(lambda: table.has_step(1, 1), 3.0), table.troubles()
    say_paused(table, False)
    table.publish_tick(1, 1)
    table.move(1, 1, "right", "right")
