"""A world that is stopped, starved or restarted is waited for; one that is able to answer and does not is not."""

from schemas import Episode, Rules, Tick
from services.referee.settings import RefereeSettings
from tests.services.referee_table import Table, start, trouble
from vantage.service import SECOND, Changed, Woken

WELL = trouble("simulator", "", "ok")
PATIENCE = int(RefereeSettings().step_patience * SECOND)


def commanded() -> Table:
    """Return a table whose simulator speaks, and owes the poses of the first step."""
    table = start()
    table.send(WELL)
    table.command("hider", 0)
    table.command("seeker", 0)
    return table


def test_a_world_that_was_stopped_executes_the_step_when_it_goes_on() -> None:
    table = commanded()
    for _ in range(60):
        table.now += SECOND // 10
        assert table.send(Woken()) == []
    table.pose("hider", 0.2, 1)
    assert table.pose("seeker", 0.6, 1) == [Tick(stamp=table.now, episode=1, step=1)]


def test_the_patience_counts_from_when_the_world_can_answer_again() -> None:
    table = commanded()
    table.now += 6 * SECOND
    table.send(WELL)  # it goes on
    back = table.now
    (aborted,) = table.wait(WELL)
    assert isinstance(aborted, Episode) and aborted.reason == "step 0 was not executed within 16 s"
    assert table.now == back + PATIENCE


def test_a_restarted_world_has_its_patience_again() -> None:
    table = commanded()
    table.send(Changed("simulator", False))
    table.now += 8 * SECOND
    assert table.wake() == []
    table.send(Changed("simulator", True))
    back = table.now
    (aborted,) = table.wait(WELL)
    assert isinstance(aborted, Episode) and table.now == back + PATIENCE


def test_a_world_that_speaks_and_does_not_answer_is_given_up() -> None:
    table = commanded()
    asked = table.now
    (aborted,) = table.wait(WELL)
    assert isinstance(aborted, Episode) and table.now == asked + PATIENCE


def test_a_world_that_is_gone_for_good_is_given_up() -> None:
    table = commanded()
    asked = table.now
    table.send(Changed("simulator", False))
    (aborted,) = table.wait()
    assert isinstance(aborted, Episode) and table.now == asked + 20 * SECOND
    assert aborted.reason == "step 0 was not executed within 20 s; simulator is not alive"


def test_a_set_up_waits_for_a_world_that_is_restarted() -> None:
    table = Table(autoplay=True, games=1, rules=Rules(step_period=0.0))
    table.arrive()
    table.send(Changed("simulator", False))
    table.now += 12 * SECOND
    assert table.wake() == []
    table.send(Changed("simulator", True))
    table.now += 5 * SECOND
    table.pose("hider", 0.2, 0)
    running, _ = table.pose("seeker", 0.6, 0)
    assert isinstance(running, Episode) and running.phase == "running"


def test_a_rehearsal_that_is_gone_does_not_hold_up_the_simulator_that_is_there() -> None:
    table = commanded()
    assert "rehearsal" in table.core.declaration.participants
    table.send(trouble("rehearsal", "", "ok"))
    table.send(Changed("rehearsal", False))
    asked = table.now
    (aborted,) = table.wait(WELL)
    assert isinstance(aborted, Episode) and table.now == asked + PATIENCE


def test_a_service_that_is_gone_no_longer_slows_the_games_down() -> None:
    table = commanded()
    table.send(trouble("rehearsal", "this machine is too slow: load 12.0 on 2 cores"))
    table.send(Changed("rehearsal", False))
    asked = table.now
    (aborted,) = table.wait(WELL)
    assert isinstance(aborted, Episode) and table.now == asked + PATIENCE
    assert "too slow" not in aborted.reason
