"""The simulator: answers set-ups with poses and pictures, moves when it has both commands."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from schemas import ColorImage, Command, DepthImage, Episode, Layout, Pose, Rules, Tick
from services.simulator.core import SimulatorCore, SimulatorSettings
from vantage.service import Arrived, Publish, Send, Unexpected
from vantage.world.camera import Camera
from vantage.world.layout import ImpossibleLayout


def published(sends: Sequence[Send]) -> dict[str, object]:
    return {send.key: send.message for send in sends if isinstance(send, Publish)}


def episode(phase: str = "setup", **rules: object) -> Episode:
    return Episode(stamp=1, episode=1, seed=5, phase=phase, rules=Rules(**rules))  # type: ignore[arg-type]


def set_up(settings: SimulatorSettings | None = None, **rules: object) -> tuple[SimulatorCore, dict[str, object]]:
    core = SimulatorCore(settings)
    return core, published(core.step(Arrived("episode", episode(**rules)), 7))


def command(core: SimulatorCore, robot: str, primitive: str, step: int = 0) -> dict[str, object]:
    message = Command(stamp=1, episode=1, step=step, primitive=primitive)  # type: ignore[arg-type]
    return published(core.step(Arrived(f"{robot}/command", message), 9))


def test_setup_publishes_everything_the_players_need_and_the_poses_last() -> None:
    core = SimulatorCore()
    sends = core.step(Arrived("episode", episode()), 7)
    keys = [send.key for send in sends if isinstance(send, Publish)]
    assert keys[0] == "layout"
    assert keys[-2:] == ["hider/pose", "seeker/pose"]
    assert set(keys[1:-2]) == {f"{robot}/{part}" for robot in ("hider", "seeker") for part in ("depth", "color")}


def test_the_start_obeys_the_rules() -> None:
    _, said = set_up(start_distance_minimum=0.3, start_distance_maximum=0.32)
    hider, seeker = said["hider/pose"], said["seeker/pose"]
    assert isinstance(hider, Pose) and isinstance(seeker, Pose)
    assert 0.3 - 1e-9 <= math.hypot(hider.x - seeker.x, hider.y - seeker.y) <= 0.32 + 1e-9
    assert (hider.stamp, hider.episode, hider.step) == (7, 1, 0)


def test_it_moves_when_it_has_both_commands() -> None:
    core, before = set_up()
    assert command(core, "hider", "backward") == {}
    after = command(core, "seeker", "left")
    start, end = before["hider/pose"], after["hider/pose"]
    assert isinstance(start, Pose) and isinstance(end, Pose)
    moved = (end.x - start.x) * math.cos(start.heading) + (end.y - start.y) * math.sin(start.heading)
    assert moved == pytest.approx(-0.010) or moved == 0.0
    turned, was = after["seeker/pose"], before["seeker/pose"]
    assert isinstance(turned, Pose) and isinstance(was, Pose)
    assert math.remainder(turned.heading - was.heading, math.tau) == pytest.approx(math.radians(10))
    assert turned.step == 1


def test_a_late_robot_stays() -> None:
    core, before = set_up()
    command(core, "seeker", "right")
    after = published(core.step(Arrived("tick", Tick(stamp=1, episode=1, step=0, late=("hider",))), 9))
    start, end = before["hider/pose"], after["hider/pose"]
    assert isinstance(start, Pose) and isinstance(end, Pose)
    assert (end.x, end.y, end.heading, end.step) == (start.x, start.y, start.heading, 1)


def test_commands_out_of_place_are_set_aside() -> None:
    core, _ = set_up()
    with pytest.raises(Unexpected):
        command(core, "hider", "stay", step=4)
    command(core, "hider", "stay")
    with pytest.raises(Unexpected, match="second"):
        command(core, "hider", "forward")
    with pytest.raises(Unexpected):
        SimulatorCore().step(Arrived("hider/command", Command(stamp=1, episode=1, primitive="stay")), 1)


@pytest.mark.parametrize(("width", "height"), [(128, 1), (64, 48), (640, 480)])
def test_pictures_have_the_configured_size(width: int, height: int) -> None:
    _, said = set_up(SimulatorSettings(camera=Camera(width=width, height=height)))
    depth, color = said["hider/depth"], said["hider/color"]
    assert isinstance(depth, DepthImage) and isinstance(color, ColorImage)
    assert (depth.width, depth.height) == (width, height)
    assert (color.width, color.height) == (width, height)
    assert np.frombuffer(depth.data, np.uint16).max() > 0


def test_an_impossible_layout_is_an_error_that_names_it() -> None:
    with pytest.raises(ImpossibleLayout, match="nowhere"):
        set_up(layout="/nowhere.json")


def test_the_same_seed_gives_the_same_world() -> None:
    first, second = set_up()[1], set_up()[1]
    assert first == second
    assert isinstance(first["layout"], Layout)
    assert len(first["layout"].obstacles) == 3
