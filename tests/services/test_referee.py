"""The referee: step protocol, catch, lateness, stalled games, restarts."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import Control, Episode, Layout, Rules, Tick
from tests.services.referee_table import REQUIRED, Table, start
from vantage.service import SECOND, Arrived, Changed, Unexpected, Woken


def test_no_game_before_every_required_service_is_alive() -> None:
    table = Table(autoplay=True)
    table.wake()
    table.wake()
    for name in REQUIRED[:-1]:
        assert table.send(Changed(name, True)) == []
    (setup,) = table.send(Changed(REQUIRED[-1], True))
    assert isinstance(setup, Episode)


@given(st.floats(0.0, 1.2), st.floats(0.0, 1.2))
def test_the_catch_is_judged_by_distance_alone(hider: float, seeker: float) -> None:
    table = start()
    (message,) = table.play_step(0, hider, seeker)
    if abs(hider - seeker) <= 0.150 + 1e-9:
        assert isinstance(message, Episode)
        assert (message.phase, message.outcome, message.caught_step) == ("ended", "caught", 1)
    else:
        assert message == Tick(stamp=table.now, episode=1, step=1)


def test_a_catch_at_exactly_the_catch_distance_counts() -> None:
    table = start()
    (message,) = table.play_step(0, 0.25, 0.25 + 0.15)
    assert isinstance(message, Episode) and message.outcome == "caught"


def test_catches_can_be_ignored() -> None:
    table = start(rules=Rules(step_period=0.0, catching=False))
    (message,) = table.play_step(0, 0.5, 0.5)
    assert isinstance(message, Tick)


def test_the_hider_survives_the_last_step() -> None:
    table = start(rules=Rules(step_period=0.0, maximum_steps=3))
    assert isinstance(table.play_step(0, 0.2, 0.6)[0], Tick)
    assert isinstance(table.play_step(1, 0.2, 0.6)[0], Tick)
    (message,) = table.play_step(2, 0.2, 0.6)
    assert isinstance(message, Episode)
    assert (message.outcome, message.step, message.caught_step) == ("survived", 3, None)


def test_real_time_paces_the_ticks() -> None:
    table = start(rules=Rules(step_period=0.25))
    assert table.play_step(0, 0.2, 0.6) == []
    before = table.now
    (tick,) = table.wake()
    assert isinstance(tick, Tick) and tick.step == 1
    assert table.now - before == SECOND // 4


def test_a_late_robot_stays_in_real_time() -> None:
    table = start(rules=Rules(step_period=0.25))
    table.play_step(0, 0.2, 0.6)
    table.wake()
    table.command("seeker", 1)
    assert table.wake() == [Tick(stamp=table.now, episode=1, step=1, late=("hider",))]
    with pytest.raises(Unexpected):
        table.command("hider", 1)


def test_a_game_without_answer_is_aborted_and_says_who_is_missing() -> None:
    table = start()
    table.command("hider", 0)
    (message,) = table.wake()
    assert isinstance(message, Episode)
    assert message.phase == "aborted" and "no command from the seeker for step 0" in message.reason


def test_a_step_that_is_not_executed_aborts_the_game_and_the_next_begins() -> None:
    table = Table(autoplay=True, rules=Rules(step_period=0.0))
    table.arrive()
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    table.command("hider", 0)
    table.command("seeker", 0)
    (aborted,) = table.wake()
    assert isinstance(aborted, Episode) and "was not executed" in aborted.reason
    (setup,) = table.wake()
    assert isinstance(setup, Episode)
    assert (setup.episode, setup.seed, setup.phase) == (2, 2, "setup")


def test_a_restarted_referee_aborts_the_game_it_finds_and_goes_on_after_it() -> None:
    table = Table(autoplay=True)
    table.wake()
    table.pose("hider", 0.2, 17, episode=5)
    for name in REQUIRED:
        table.send(Changed(name, True))
    aborted, setup = table.wake()
    assert isinstance(aborted, Episode) and isinstance(setup, Episode)
    assert (aborted.episode, aborted.phase) == (5, "aborted")
    assert (setup.episode, setup.phase, setup.seed) == (6, "setup", 6)


def test_commands_tell_of_a_game_too_when_simulator_and_referee_were_restarted() -> None:
    table = Table()
    table.wake()
    table.send(Arrived("control", Control(stamp=0, action="start", seed=42)))
    table.command("seeker", 3, episode=7)
    for name in REQUIRED:
        table.send(Changed(name, True))
    aborted, setup = table.wake()
    assert isinstance(aborted, Episode) and isinstance(setup, Episode)
    assert (aborted.episode, aborted.phase) == (7, "aborted")
    assert (setup.episode, setup.phase, setup.seed) == (8, "setup", 42)


def test_control_starts_and_stops_games() -> None:
    table = Table()
    assert table.arrive() == []
    (setup,) = table.send(Arrived("control", Control(stamp=0, action="start", seed=42, games=2)))
    assert isinstance(setup, Episode) and (setup.seed, setup.episode) == (42, 1)
    (aborted,) = table.send(Arrived("control", Control(stamp=0, action="stop")))
    assert isinstance(aborted, Episode) and aborted.reason == "stopped on request"
    assert table.core.wake_at() is None


def test_a_second_wish_replaces_the_running_game() -> None:
    table = Table()
    table.arrive()
    table.send(Arrived("control", Control(stamp=0, action="start", seed=42)))
    table.now += SECOND
    aborted, setup = table.send(Arrived("control", Control(stamp=0, action="start", seed=77)))
    assert isinstance(aborted, Episode) and isinstance(setup, Episode)
    assert aborted.phase == "aborted" and (setup.seed, setup.episode) == (77, 2)


def test_a_flood_of_wishes_sets_up_no_more_games_than_the_world_can_answer() -> None:
    table = Table()
    table.arrive()
    said: list[object] = []
    for seed in range(10_000):
        table.now += SECOND // 10_000
        said += table.ask("start", seed=seed)
        if (wake := table.core.wake_at()) is not None and wake <= table.now:
            said += table.send(Woken())
    assert len([message for message in said if isinstance(message, Episode) and message.phase == "setup"]) <= 11
    while table.core.wake_at() is not None and said[-1].seed != 9999:  # type: ignore[attr-defined]
        said += table.wake()
    assert isinstance(said[-1], Episode) and (said[-1].phase, said[-1].seed) == ("setup", 9999), "the last one is played"


def test_strangers_messages_are_set_aside() -> None:
    table = start()
    for robot in ("hider", "seeker"):
        with pytest.raises(Unexpected):
            table.pose(robot, 0.3, 7)
        with pytest.raises(Unexpected):
            table.command(robot, 0, episode=9)
        with pytest.raises(Unexpected):
            table.command(robot, 5)


def test_a_layout_renews_the_patience_of_the_set_up() -> None:
    """Robots may need longer than any fixed time to drive to their starts; a world that falls silent is given up."""
    table = Table(autoplay=True, games=1, setup_patience=10.0)
    (setup,) = table.arrive()
    began = table.now
    for _ in range(5):
        table.now += 9 * SECOND
        assert table.send(Arrived("layout", Layout(stamp=table.now, episode=setup.episode))) == []  # type: ignore[attr-defined]
        assert table.core.wake_at() == table.now + 10 * SECOND
    table.send(Arrived("layout", Layout(stamp=table.now, episode=99)))  # of another game: says nothing of this one
    (aborted,) = table.wake()
    assert isinstance(aborted, Episode) and aborted.phase == "aborted" and table.now == began + 55 * SECOND


def test_a_set_up_has_an_end_however_often_the_layout_is_said() -> None:
    table = Table(autoplay=True, games=1, setup_patience=10.0, setup_limit=60.0)
    (setup,) = table.arrive()
    began = table.now
    while table.now < began + 59 * SECOND:
        table.now += 2 * SECOND
        table.send(Arrived("layout", Layout(stamp=table.now, episode=setup.episode)))  # type: ignore[attr-defined]
    (aborted,) = table.wake()
    assert isinstance(aborted, Episode) and aborted.phase == "aborted" and table.now == began + 60 * SECOND


def test_a_layout_of_another_game_does_not_renew_the_patience_of_the_set_up() -> None:
    table = Table(autoplay=True, games=1, setup_patience=10.0)
    (setup,) = table.arrive()
    assert isinstance(setup, Episode)
    began = table.now
    for number in (0, setup.episode + 1):
        table.now += 4 * SECOND
        table.send(Arrived("layout", Layout(stamp=table.now, episode=number)))
    (aborted,) = table.wake()
    assert isinstance(aborted, Episode) and aborted.phase == "aborted" and table.now == began + 10 * SECOND
