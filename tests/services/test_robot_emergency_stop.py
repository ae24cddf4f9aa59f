"""An emergency stop is cleared by a person who asks for a game, and by nothing else."""

from __future__ import annotations

import math

import pytest

from schemas import ROBOTS, Command, Control, Episode
from services.robot.link import Link
from tests.drive.emulated import EmulatedTable
from tests.services.robot_play import SEED, ask_for_games, at_start, play
from vantage.drive.protocol import EMERGENCY_STOP, EmergencyStop, Telemetry, encode
from vantage.service import SECOND


def latch(table: EmulatedTable) -> None:
    """Press and release the hider's button."""
    for pressed in (True, False):
        table.firmwares["hider"].button = pressed
        table.run(lambda: False, 0.2)


HELD = "emergency stop of robot hider: release it and ask for a game (`vantage play`)"


def test_an_emergency_stop_is_cleared_when_a_person_asks_for_a_game_once_the_button_is_released() -> None:
    table = at_start()
    table.firmwares["hider"].button = True
    table.run(lambda: False, 0.1)
    motions = play(table, "forward", "forward")
    assert (motions["hider"].result, motions["hider"].reason) == ("stopped", HELD)
    assert motions["seeker"].result == "completed"
    assert table.core.trouble == HELD
    table.firmwares["hider"].button = False
    table.run(lambda: False, 0.3)
    assert table.core.trouble == HELD  # released is not cleared
    table.motions.clear()
    ask_for_games(table)
    table.set_up(number=2, seed=SEED)
    assert table.run(lambda: len(table.motions) == 2, 20.0)
    assert {motion.result for _, motion in table.motions} == {"completed"}
    assert table.core.trouble == ""


def test_the_next_of_ten_games_asked_for_before_it_does_not_clear_an_emergency_stop() -> None:
    table = at_start()
    ask_for_games(table, games=10)
    latch(table)
    before = {robot: table.place_of(robot) for robot in ROBOTS}
    for number in (2, 3):
        table.motions.clear()
        table.set_up(number=number, seed=SEED + 1)
        assert table.run(lambda: len(table.motions) == 2, 3.0)
        assert {(motion.step, motion.result, motion.reason) for _, motion in table.motions} == {(0, "stopped", HELD)}
        table.say("episode", Episode(stamp=table.now, episode=number, seed=SEED + 1, phase="aborted"))
    assert table.firmwares["hider"].flags & EMERGENCY_STOP
    assert all(math.dist(before[robot][:2], table.place_of(robot)[:2]) < 0.0005 for robot in ROBOTS)
    assert table.core.trouble == HELD


@pytest.mark.parametrize("pressed_again", [False, True])
def test_who_asks_while_the_button_is_pressed_or_before_it_is_pressed_again_must_ask_again(pressed_again: bool) -> None:
    table = at_start()
    if pressed_again:
        latch(table)
        ask_for_games(table)
        latch(table)
    else:
        table.firmwares["hider"].button = True
        table.run(lambda: False, 0.2)
        ask_for_games(table)
        table.firmwares["hider"].button = False
        table.run(lambda: False, 0.2)
    table.motions.clear()
    table.set_up(number=2, seed=SEED)
    assert table.run(lambda: len(table.motions) == 2, 3.0)
    assert {motion.result for _, motion in table.motions} == {"stopped"}
    assert table.firmwares["hider"].flags & EMERGENCY_STOP


def test_a_request_that_comes_again_is_not_a_person_who_asks_again() -> None:
    table = at_start()
    ask_for_games(table, request="mine")
    latch(table)
    ask_for_games(table, request="mine")
    table.motions.clear()
    table.set_up(number=2, seed=SEED)
    table.run(lambda: False, 0.4)
    assert table.firmwares["hider"].flags & EMERGENCY_STOP and table.motions == []
    ask_for_games(table, request="another")
    assert table.run(lambda: len(table.motions) == 2, 20.0)


@pytest.mark.parametrize("silent_when_asked", [False, True])
def test_who_asks_while_the_robot_is_out_of_reach_or_before_must_ask_again(silent_when_asked: bool) -> None:
    """Somebody may have pressed the button meanwhile."""
    table = at_start()
    latch(table)
    if not silent_when_asked:
        ask_for_games(table)
    table.firmwares["hider"].powered = False
    table.run(lambda: False, 1.0)
    if silent_when_asked:
        ask_for_games(table)
    table.firmwares["hider"].powered = True
    table.run(lambda: False, 0.3)
    table.motions.clear()
    table.set_up(number=2, seed=SEED)
    assert table.run(lambda: len(table.motions) == 2, 3.0)
    assert {motion.result for _, motion in table.motions} == {"stopped"}
    assert table.firmwares["hider"].flags & EMERGENCY_STOP


def test_the_wish_may_be_heard_just_after_the_game_it_led_to_and_the_wish_to_stop_is_none() -> None:
    table = at_start()
    latch(table)
    table.motions.clear()
    table.say("control", Control(stamp=table.now, action="stop"))
    table.set_up(number=2, seed=SEED)
    table.run(lambda: False, 0.4)
    assert table.firmwares["hider"].flags & EMERGENCY_STOP and table.motions == []
    ask_for_games(table)
    assert table.run(lambda: len(table.motions) == 2, 20.0)
    assert {motion.result for _, motion in table.motions} == {"completed"}


def test_an_emergency_stop_in_mid_motion_ends_it() -> None:
    table = at_start()
    table.say("hider/command", Command(stamp=table.now, episode=1, step=0, primitive="forward"))
    table.say("seeker/command", Command(stamp=table.now, episode=1, step=0, primitive="stay"))
    table.run(lambda: table.bodies["hider"].left_speed > 0.03, 1.0)
    table.firmwares["hider"].feed(encode(EmergencyStop(60_000)), table.now)
    assert table.run(lambda: len(table.motions) == 2, 2.0)
    assert dict(table.motions)["hider"].result == "stopped"


def test_who_asks_before_a_port_is_opened_again_must_ask_again() -> None:
    """However short that was: somebody may have pressed the button meanwhile, or it is another robot."""
    link = Link("hider", "/dev/x", silence=0.5)
    now = 10**15
    latched = Telemetry(0, 8000, 0, 0, 0, 8000, EMERGENCY_STOP)
    link.hear(encode(latched), now)
    link.asked()
    assert link.may_clear
    link.opened(now + SECOND // 10)
    link.hear(encode(latched), now + SECOND // 8)
    assert link.can_clear and not link.may_clear
