"""The referee's clock is held and let go, and games are taken back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from schemas import Episode, Rules, Tick
from tests.services.referee_table import PACED, Table, start
from vantage.service import SECOND, Unexpected, Woken


def running(message: object) -> bool:
    """Return whether a message says that the game is paused; fail if it is no running game's."""
    assert isinstance(message, Episode) and message.phase == "running"
    return message.paused


def test_a_pause_finishes_the_step_and_holds_the_tick_until_it_is_lifted() -> None:
    table = start(rules=PACED)
    (said,) = table.ask("pause")
    assert running(said)
    assert table.play_step(0, 0.2, 0.6) == [] and table.core.wake_at() is None
    table.now += 3600 * SECOND
    assert table.send(Woken()) == []
    said, tick = table.ask("resume", speed=3.0)
    assert not running(said) and tick == Tick(stamp=table.now, episode=1, step=1)
    assert table.play_step(1, 0.2, 0.6) == []
    before = table.now
    (tick,) = table.wake()
    assert tick == Tick(stamp=before + SECOND // 4, episode=1, step=2)


def test_a_pause_shorter_than_the_step_does_not_hurry_the_next() -> None:
    table = start(rules=PACED)
    began = table.now
    table.play_step(0, 0.2, 0.6)
    assert table.core.wake_at() == began + SECOND // 4
    table.ask("pause")
    assert table.core.wake_at() is None
    table.now += SECOND // 10
    (said,) = table.ask("resume")
    assert not running(said)
    assert table.wake() == [Tick(stamp=began + SECOND // 4, episode=1, step=1)]


def test_a_paused_step_keeps_its_patience_and_the_catch_is_judged() -> None:
    table = start(rules=PACED)
    table.play_step(0, 0.2, 0.6)
    table.wake()
    table.command("seeker", 1)
    table.ask("pause")
    assert table.wake() == [Tick(stamp=table.now, episode=1, step=1, late=("hider",))]
    table.pose("hider", 0.5, 2)
    (ended,) = table.pose("seeker", 0.6, 2)
    assert isinstance(ended, Episode)
    assert (ended.outcome, ended.caught_step, ended.paused) == ("caught", 2, False)  # no game is to follow


def test_a_paused_game_that_is_not_executed_is_aborted_and_the_next_one_waits() -> None:
    table = Table(autoplay=True, games=2, rules=PACED)
    table.arrive()
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    table.ask("pause")
    table.command("hider", 0)
    table.command("seeker", 0)
    (aborted,) = table.wake()
    assert isinstance(aborted, Episode) and "was not executed" in aborted.reason and aborted.paused
    assert table.wake() == [] and table.core.wake_at() is None
    (setup,) = table.ask("resume")
    assert isinstance(setup, Episode) and (setup.phase, setup.episode, setup.paused) == ("setup", 2, False)


@pytest.mark.parametrize("waited", [False, True], ids=["lifted before the rest is over", "lifted after it"])
def test_a_pause_between_games_holds_the_next(waited: bool) -> None:
    table = Table(autoplay=True, games=2, rules=Rules(maximum_steps=1, step_period=0.25))
    table.arrive()
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    table.play_step(0, 0.2, 0.6)
    assert table.ask("pause") == []
    if waited:
        assert table.wake() == [] and table.core.wake_at() is None
        (setup,) = table.ask("resume")
    else:
        assert table.ask("resume") == []
        (setup,) = table.wake()
    assert isinstance(setup, Episode) and (setup.phase, setup.episode) == ("setup", 2)


def test_a_pause_in_the_set_up_holds_the_first_tick() -> None:
    table = Table(autoplay=True, games=1, rules=Rules(step_period=0.0))
    table.arrive()
    assert table.ask("pause") == []  # a set-up said again would be another one
    table.pose("hider", 0.2, 0)
    (said,) = table.pose("seeker", 0.6, 0)
    assert running(said) and table.core.wake_at() is None
    said, tick = table.ask("resume")
    assert not running(said) and tick == Tick(stamp=table.now, episode=1, step=0)


def test_stop_and_start_end_a_pause() -> None:
    table = start(rules=PACED)
    table.ask("pause")
    (aborted,) = table.ask("stop")
    assert isinstance(aborted, Episode) and (aborted.reason, aborted.paused) == ("stopped on request", False)
    (setup,) = table.ask("start", seed=9, games=2)
    assert isinstance(setup, Episode) and setup.phase == "setup"
    table.ask("pause")
    table.now += SECOND
    aborted, setup = table.ask("start", seed=7)
    assert isinstance(aborted, Episode) and isinstance(setup, Episode)
    assert (aborted.phase, aborted.paused, setup.phase, setup.seed) == ("aborted", False, "setup", 7)
    with pytest.raises(Unexpected, match="nothing is paused"):
        table.ask("resume")


def test_wishes_that_make_no_sense_are_set_aside() -> None:
    table = Table()
    table.arrive()
    for action in ("pause", "resume", "seek", "discard"):
        with pytest.raises(Unexpected):
            table.ask(action, episode=1)
    table = start()
    assert running(table.ask("pause")[0]) and table.ask("pause") == []
    with pytest.raises(Unexpected, match="replay"):
        table.ask("seek", position=3.0)
    with pytest.raises(Unexpected, match="no episode 2"):
        table.ask("discard", episode=2)


def test_the_running_game_is_discarded_and_a_finished_one_is_left_alone() -> None:
    table = Table(autoplay=True, games=2, rules=Rules(maximum_steps=1, step_period=0.0))
    table.arrive()
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    table.play_step(0, 0.2, 0.6)
    assert table.ask("discard", episode=1) == []
    table.wake()
    assert table.ask("discard", episode=1) == []
    (aborted,) = table.ask("discard", episode=2)
    assert isinstance(aborted, Episode)
    assert (aborted.episode, aborted.phase, aborted.reason) == (2, "aborted", "discarded by the player")


@given(st.lists(st.tuples(st.integers(0, 25), st.sampled_from(["pause", "resume"])), max_size=12), st.sampled_from([0.0, 0.25]))
def test_pauses_change_nothing_but_the_clock(wishes: list[tuple[int, str]], period: float) -> None:
    """The same game, message for message, whenever the clock was held; while it is held no step is opened."""

    def play(wishes: list[tuple[int, str]]) -> list[object]:
        table = Table(autoplay=True, games=1, rules=Rules(maximum_steps=4, step_period=period))
        sent = table.arrive()
        said = list(sent)
        held = False
        todo = sorted(wishes)
        poses = 0
        for turn in range(200):
            if said and isinstance(said[-1], Episode) and said[-1].phase == "ended":
                break
            before = held
            if todo and (todo[0][0] <= turn):
                _, action = todo.pop(0)
                if (action == "resume") != held:
                    continue
                sent, held = table.ask(action), action == "pause"
            elif poses == 0 or len([message for message in said if isinstance(message, Tick)]) == poses:
                step = poses
                if step:
                    table.command("hider", step - 1)
                    table.command("seeker", step - 1)
                table.pose("hider", 0.2, step)
                sent = table.pose("seeker", 0.6, step)
                poses += 1
            elif held and not todo:
                sent, held = table.ask("resume"), False
            elif table.core.wake_at() is None:
                assert held
                continue
            else:
                sent = table.wake()
            if before and held:
                assert not any(isinstance(message, Tick) for message in sent)
            said += sent
        return said

    def content(messages: list[object]) -> list[object]:
        kept: list[object] = []
        for message in messages:
            assert isinstance(message, Episode | Tick)
            repeated = isinstance(message, Episode) and message.phase == "running" and any(map(_runs, kept))
            if not repeated:
                kept.append(replace(message, stamp=0, **({"paused": False} if isinstance(message, Episode) else {})))
        return kept

    assert content(play(wishes)) == content(play([]))


def _runs(message: object) -> bool:
    return isinstance(message, Episode) and message.phase == "running"
