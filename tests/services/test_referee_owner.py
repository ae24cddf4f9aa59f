"""Games belong to whoever asked for them: known by their request, played once, and ended when their owner leaves the bus."""

import pytest

from schemas import Control, Episode, Rules
from tests.services.referee_table import PACED, Table
from vantage.service import SECOND, Arrived, Changed, Unexpected

OWNER = "command-line"


def owned(request: str = "mine", games: int = 3, rules: Rules = PACED) -> Table:
    """Return a table on which the first game of an owner that is there runs."""
    table = Table()
    table.arrive()
    table.send(Changed(OWNER, True))
    (setup,) = table.ask("start", request=request, owner=OWNER, games=games, seed=5, rules=rules)
    assert isinstance(setup, Episode) and (setup.request, setup.seed) == (request, 5)
    table.pose("hider", 0.2, 0)
    running, _ = table.pose("seeker", 0.6, 0)
    assert isinstance(running, Episode) and running.request == request
    return table


def hear_itself(table: Table, said: list[object]) -> list[object]:
    """Let the referee hear what it says on `control`, as on a bus."""
    return [message for control in said for message in table.send(Arrived("control", control))]


def test_games_end_when_their_owner_has_left_the_bus() -> None:
    table = owned()
    left = table.now
    table.send(Changed(OWNER, False))
    (control,) = table.wake()
    assert table.now - left == SECOND, "within two seconds, with the time that the bus takes to see it"
    assert isinstance(control, Control) and (control.action, control.request) == ("stop", "mine")
    (aborted,) = hear_itself(table, [control])
    assert isinstance(aborted, Episode) and aborted.phase == "aborted"
    assert aborted.reason == "stopped: the command that asked for these games has ended"
    assert table.core.wake_at() is None, "no other game follows"


@pytest.mark.parametrize("phase", ["between games", "paused"])
def test_games_that_do_not_run_end_with_their_owner_too(phase: str) -> None:
    table = owned(games=3, rules=Rules(step_period=0.25, maximum_steps=1))
    if phase == "paused":
        table.ask("pause")
    else:
        (ended,) = table.play_step(0, 0.2, 0.6)
        assert isinstance(ended, Episode) and ended.phase == "ended"
    table.send(Changed(OWNER, False))
    (control,) = table.wait()
    said = hear_itself(table, [control])
    assert [message.phase for message in said if isinstance(message, Episode)] == (["aborted"] if phase == "paused" else [])
    assert not any(isinstance(message, Episode) and message.paused for message in said)
    assert table.core.wake_at() is None
    with pytest.raises(Unexpected):
        table.ask("resume")


def test_an_owner_that_is_back_at_once_keeps_its_games() -> None:
    table = owned()
    table.send(Changed(OWNER, False))
    table.now += SECOND - 1
    table.send(Changed(OWNER, True))
    table.command("hider", 0)
    table.command("seeker", 0)
    table.pose("hider", 0.2, 1)
    table.pose("seeker", 0.6, 1)
    (tick,) = table.wake()
    assert not isinstance(tick, Control | Episode)


def test_an_owner_that_was_never_there_is_waited_for_no_longer() -> None:
    """It may have died between its wish and the referee's first look at who is there."""
    table = Table()
    table.arrive()
    table.ask("start", request="mine", owner=OWNER, games=0)
    (control,) = table.wake()
    assert isinstance(control, Control) and control.action == "stop"


def test_games_without_an_owner_go_on() -> None:
    table = Table()
    table.arrive()
    table.send(Changed(OWNER, True))
    table.ask("start", request="detached", games=2)
    table.send(Changed(OWNER, False))
    table.pose("hider", 0.2, 0)
    running, _ = table.pose("seeker", 0.6, 0)
    assert isinstance(running, Episode) and running.phase == "running"
    table.now += 5 * SECOND
    assert table.core.wake_at() is not None


def test_an_owner_of_games_that_are_over_may_leave() -> None:
    table = owned(games=1, rules=Rules(step_period=0.0, maximum_steps=1))
    (ended,) = table.play_step(0, 0.2, 0.6)
    assert isinstance(ended, Episode) and ended.phase == "ended"
    table.send(Changed(OWNER, False))
    assert table.wake() == [] and table.core.wake_at() is None


def test_another_ones_games_do_not_end_with_the_owner_of_those_before() -> None:
    table = owned()
    table.send(Changed(OWNER, False))
    (control,) = table.wake()
    aborted, setup = table.ask("start", request="theirs", games=2)
    assert isinstance(aborted, Episode) and isinstance(setup, Episode)
    assert (aborted.request, setup.request) == ("mine", "theirs")
    assert hear_itself(table, [control]) == [], "a stop is of one request"


def test_a_request_that_comes_again_starts_nothing() -> None:
    table = owned()
    assert table.ask("start", request="mine", owner=OWNER, seed=6, games=2) == []
    (aborted,) = table.ask("stop", request="mine", reason="Ctrl-C")
    assert isinstance(aborted, Episode) and aborted.reason == "stopped: Ctrl-C"
    assert table.ask("start", request="mine", owner=OWNER) == [], "nor when it was stopped meanwhile"


def test_a_stopped_request_that_comes_late_starts_nothing() -> None:
    table = Table()
    table.arrive()
    assert table.ask("stop", request="mine") == []
    assert table.ask("start", request="mine") == []


def test_wishes_without_a_request_are_all_played() -> None:
    table = Table()
    table.arrive()
    assert len(table.ask("start")) == 1
    table.now += SECOND
    assert len(table.ask("start")) == 2


@pytest.mark.parametrize("wish", [{"owner": "seeker", "request": "mine"}, {"owner": OWNER}])
def test_an_owner_that_nobody_watches_is_refused(wish: dict[str, str]) -> None:
    table = Table()
    table.arrive()
    with pytest.raises(Unexpected, match="owner"):
        table.ask("start", **wish)
