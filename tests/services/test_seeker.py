"""The seeker: joins what belongs together, plays what the episode says, and finds, chases and catches."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from schemas import PRIMITIVES, ColorImage, Command, DepthImage, Episode, Message, Players, Pose, Rules, StateImage, Tick
from services.seeker.core import SeekerCore, SeekerSettings
from services.seeker.policy import CHASE, EXPLORE, PRESETS, RECALL, SeekerMemory, reset, seeker_step
from services.simulator.core import SimulatorCore
from vantage.perception.seen_map import occupancy_of
from vantage.perception.state_image import perceive
from vantage.service import Arrived, Publish, Unexpected
from vantage.world.arena import BACKWARD, FORWARD, STAY, TURN
from vantage.world.camera import Camera, render
from vantage.world.layout import boxes_array, make_layout
from vantage.world.motion import apply_primitive
from vantage.world.start import draw_start

KEYS = ("seeker/pose", "seeker/depth", "seeker/color", "tick")


def episode(number: int = 1, phase: str = "setup", seeker: str = "glancing", seed: int = 5, **rules: object) -> Episode:
    return Episode(
        stamp=1,
        episode=number,
        seed=seed,
        phase=phase,  # type: ignore[arg-type]
        rules=Rules(**rules),  # type: ignore[arg-type]
        players=Players(seeker=seeker),
    )


@dataclass
class Table:
    """A real simulator, and one game's messages as they come."""

    start: Episode
    simulator: SimulatorCore = field(default_factory=SimulatorCore)
    messages: dict[str, Message] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._collect(Arrived("episode", self.start))

    def _collect(self, arrived: Arrived) -> None:
        for send in self.simulator.step(arrived, 1_000 + self.step * 10):
            if isinstance(send, Publish):
                self.messages[send.key] = send.message

    @property
    def step(self) -> int:
        return self.messages["seeker/pose"].step if self.messages else 0

    @property
    def distance(self) -> float:
        hider, seeker = self.messages["hider/pose"], self.messages["seeker/pose"]
        assert isinstance(hider, Pose) and isinstance(seeker, Pose)
        return math.hypot(hider.x - seeker.x, hider.y - seeker.y)

    def view(self) -> list[tuple[str, Message]]:
        """What the seeker gets at this step."""
        tick = Tick(stamp=1, episode=self.start.episode, step=self.step)
        return [(key, self.messages.get(key, tick) if key != "tick" else tick) for key in KEYS]

    def move(self, hider: str, seeker: str) -> None:
        for robot, primitive in (("hider", hider), ("seeker", seeker)):
            command = Command(stamp=1, episode=self.start.episode, step=self.step, primitive=primitive)  # type: ignore[arg-type]
            self._collect(Arrived(f"{robot}/command", command))


def answer(core: SeekerCore, view: list[tuple[str, Message]]) -> dict[str, Message]:
    said: dict[str, Message] = {}
    for key, message in view:
        for send in core.step(Arrived(key, message), 1):
            assert isinstance(send, Publish)
            said[send.key] = send.message
    return said


def seated(start: Episode | None = None, settings: SeekerSettings | None = None) -> tuple[SeekerCore, Table]:
    start = start or episode()
    core = SeekerCore(settings)
    assert not core.step(Arrived("episode", start), 1)
    return core, Table(start)


def command_of(said: dict[str, Message]) -> Command:
    command = said["seeker/command"]
    assert isinstance(command, Command)
    return command


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_the_answer_does_not_depend_on_the_order_of_arrival(order: tuple[int, ...]) -> None:
    core, table = seated()
    expected = answer(core, table.view())
    other, _ = seated()
    view = table.view()
    said = answer(other, [view[i] for i in order])
    assert said == expected
    assert set(said) == {"seeker/command", "seeker/view"}


def test_answers_carry_the_stamp_of_the_depth_image_and_the_view_is_what_is_perceived() -> None:
    core, table = seated()
    said = answer(core, table.view())
    depth, color, pose = (table.messages[f"seeker/{part}"] for part in ("depth", "color", "pose"))
    assert isinstance(depth, DepthImage) and isinstance(color, ColorImage) and isinstance(pose, Pose)
    for message in said.values():
        assert (message.stamp, message.episode, message.step) == (depth.stamp, 1, 0)
    view = said["seeker/view"]
    perceived = perceive(depth, color, pose, "seeker")
    assert isinstance(view, StateImage)
    assert view.data == perceived.image.tobytes()
    assert perceived.other is not None
    assert (view.other_x, view.other_y) == perceived.other


def test_the_view_can_be_left_out() -> None:
    core, table = seated(settings=SeekerSettings(publish_view=False))
    with_view, _ = seated()
    for _ in range(30):
        said = answer(core, table.view())
        assert set(said) == {"seeker/command"}
        assert command_of(answer(with_view, table.view())) == command_of(said)
        table.move("left", command_of(said).primitive)


def test_an_incomplete_step_gets_no_answer() -> None:
    core, table = seated()
    for left_out in KEYS:
        fresh, _ = seated()
        assert not answer(fresh, [item for item in table.view() if item[0] != left_out])
    assert answer(core, table.view())


def test_what_makes_no_sense_is_set_aside() -> None:
    core, table = seated(episode(number=3))
    first = table.view()
    answer(core, first)
    with pytest.raises(Unexpected, match="late"):
        core.step(Arrived(*first[0]), 1)
    table.move("stay", "left")
    second = table.view()
    core.step(Arrived(*second[0]), 1)
    with pytest.raises(Unexpected, match="twice"):
        core.step(Arrived(*second[0]), 1)
    with pytest.raises(Unexpected, match="late"):
        core.step(Arrived("tick", Tick(stamp=1, episode=2, step=9)), 1)
    with pytest.raises(Unexpected, match="episode 2"):
        core.step(Arrived("episode", episode(number=2, phase="running")), 1)
    assert answer(core, second[1:])


def test_an_unknown_preset_is_named_and_the_next_episode_plays() -> None:
    core = SeekerCore()
    with pytest.raises(Unexpected, match=r"`psychic`.*expert, glancing"):
        core.step(Arrived("episode", episode(seeker="psychic")), 1)
    assert not answer(core, Table(episode()).view())
    core.step(Arrived("episode", episode(number=2)), 1)
    assert answer(core, Table(episode(number=2)).view())


def test_it_joins_a_running_game_in_the_middle() -> None:
    table = Table(episode())
    for _ in range(7):
        table.move("left", "right")
    core = SeekerCore()
    core.step(Arrived("episode", episode(phase="running")), 1)
    assert command_of(answer(core, table.view())).step == 7
    core.step(Arrived("episode", episode(phase="running")), 1)
    table.move("left", "right")
    assert command_of(answer(core, table.view())).step == 8


@pytest.mark.parametrize("phase", ["ended", "aborted"])
def test_it_rests_after_the_game(phase: str) -> None:
    core, table = seated()
    answer(core, table.view())
    core.step(Arrived("episode", episode(phase=phase)), 1)
    table.move("stay", "stay")
    assert not answer(core, table.view())


def test_messages_of_the_next_game_may_come_before_it_is_announced() -> None:
    core, table = seated()
    answer(core, table.view())
    following = Table(episode(number=2, seed=6))
    assert not answer(core, following.view())
    sends = core.step(Arrived("episode", episode(number=2, seed=6)), 1)
    fresh, _ = seated(episode(number=2, seed=6))
    said = answer(fresh, following.view())
    assert [send.message for send in sends if isinstance(send, Publish)] == list(said.values())


@pytest.mark.parametrize("preset", sorted(PRESETS))
@pytest.mark.parametrize("seed", range(1, 7))
def test_a_hider_that_turns_on_the_spot_is_caught_as_fast_as_one_can_drive(seed: int, preset: str) -> None:
    core, table = seated(episode(seeker=preset, seed=seed))
    start = table.distance
    while table.distance > 0.150 and table.step < 80:
        table.move("left", command_of(answer(core, table.view())).primitive)
    assert table.distance <= 0.150
    assert table.step <= (start - 0.150) / 0.010 + 14


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_where_catches_are_ignored_it_stays_beside_the_hider_and_faces_it(preset: str) -> None:
    core, table = seated(episode(seeker=preset, seed=2, catching=False))
    for _ in range(150):
        table.move("stay", command_of(answer(core, table.view())).primitive)
    pose, hider = table.messages["seeker/pose"], table.messages["hider/pose"]
    assert isinstance(pose, Pose) and isinstance(hider, Pose)
    assert table.distance <= 0.150
    bearing = math.atan2(hider.y - pose.y, hider.x - pose.x)
    assert math.cos(bearing - pose.heading) > math.cos(math.radians(7))


def test_the_same_game_twice_and_another_seed_explores_differently() -> None:
    def game(seed: int) -> list[str]:
        """A hider that is carried away: the seeker gets views of an empty table."""
        core = SeekerCore()
        core.step(Arrived("episode", episode(seed=seed)), 1)
        empty = Wanderer(seed=5)
        return [PRIMITIVES[empty.step(core)] for _ in range(150)]

    assert game(5) == game(5)
    assert game(5) != game(6)


class Wanderer:
    """A seeker alone on a table: its views through the camera, its moves through the world."""

    def __init__(self, seed: int) -> None:

        self.boxes = boxes_array(make_layout("random", seed))
        self.x, self.y, self.heading = draw_start(self.boxes, 1.2, 1.2, seed, 0.25, 0.45)[1]
        self.camera = Camera()
        self.number, self.seed = 0, seed
        self.refused = 0
        self.places: list[tuple[float, float]] = []

    def step(self, core: SeekerCore) -> int:

        depth, color = np.zeros((1, 128), np.uint16), np.zeros((1, 128, 3), np.uint8)
        nowhere = (math.nan, math.nan)
        render(
            self.camera, self.boxes, 1.2, 1.2, self.x, self.y, self.heading * TURN, *nowhere, 0, 1, self.number, 1, depth, color
        )
        common = {"stamp": 1, "episode": 1, "step": self.number}
        picture = {**common, "width": 128, "height": 1, "intrinsics": self.camera.intrinsics()}
        said = answer(
            core,
            [
                ("seeker/pose", Pose(**common, x=self.x, y=self.y, heading=self.heading * TURN)),
                ("seeker/depth", DepthImage(**picture, data=depth.tobytes())),
                ("seeker/color", ColorImage(**picture, data=color.tobytes())),
                ("tick", Tick(**common)),
            ],
        )
        primitive = PRIMITIVES.index(command_of(said).primitive)
        self.x, self.y, self.heading, moved = apply_primitive(
            self.boxes, 1.2, 1.2, self.x, self.y, self.heading, primitive, *nowhere
        )
        self.refused += not moved
        self.number += 1
        self.places.append((self.x, self.y))
        return primitive


@pytest.mark.parametrize("preset", sorted(PRESETS))
@pytest.mark.parametrize("seed", range(1, 7))
def test_alone_it_explores_the_whole_table_without_getting_stuck(seed: int, preset: str) -> None:
    core = SeekerCore(SeekerSettings(publish_view=False))
    core.step(Arrived("episode", episode(seed=seed, seeker=preset)), 1)
    alone = Wanderer(seed)
    primitives = [alone.step(core) for _ in range(800)]
    assert core._memory.mode == EXPLORE
    assert STAY not in primitives
    assert alone.refused <= 16
    assert primitives.count(FORWARD) > 300
    assert primitives.count(BACKWARD) <= 8
    free = occupancy_of(alone.boxes) == 1
    free[:2], free[-2:], free[:, :2], free[:, -2:] = False, False, False, False
    seen = core._memory.last_seen[free]
    assert (seen >= 0).mean() > 0.97
    assert (seen > 400).mean() > 0.9  # and goes on doing so
    places = np.array(alone.places)
    assert all(np.ptp(places[start : start + 120], axis=0).max() > 0.05 for start in range(0, 680, 40))


def policy(memory: SeekerMemory, preset: str, step: int, x: float, seen: int, whole: bool, other_x: float) -> int:
    """The policy in the middle of an empty table, facing +x, with the hider on the same line."""
    ranges, kinds = np.full(128, 1.1 - x), np.ones(128, np.uint8)
    attention = PRESETS[preset]
    return int(seeker_step(memory, *attention, 1, step, ranges, kinds, 68.6, 63.5, x, 0.6, 0.0, seen, whole, other_x, 0.6))


def test_the_glancing_seeker_sees_the_hider_only_at_its_looks() -> None:
    memory, interval = SeekerMemory.empty(), PRESETS["glancing"].look_interval
    for step in range(2 * interval + 1):
        if step == interval:
            assert memory.points[0].tolist() == [0.7, 0.6]
        policy(memory, "glancing", step, 0.2, 30, True, 0.7 + 0.004 * step)
        assert memory.mode == CHASE
    assert memory.points[0].tolist() == pytest.approx([0.7 + 0.004 * 2 * interval, 0.6])


def test_a_look_needs_the_whole_disc_for_the_glancing_and_two_columns_for_the_expert() -> None:
    glancing, expert = SeekerMemory.empty(), SeekerMemory.empty()
    interval = PRESETS["glancing"].look_interval
    for step in range(interval + 1):
        policy(glancing, "glancing", step, 0.2, 30, step == 0, 0.7)
        policy(expert, "expert", step, 0.2, 2, False, 0.7)
        assert glancing.mode == (RECALL if step == interval else CHASE)
        assert expert.mode == CHASE
    policy(expert, "expert", interval + 1, 0.2, 1, False, 0.9)
    assert expert.mode == RECALL
    assert expert.points[0].tolist() == [0.7, 0.6]


def test_between_its_looks_the_exploring_seeker_is_blind() -> None:
    for preset, attention in PRESETS.items():
        memory = SeekerMemory.empty()
        policy(memory, preset, 0, 0.2, 1, False, 0.7)
        assert memory.mode == EXPLORE
        for step in range(1, attention.look_interval):
            policy(memory, preset, step, 0.2, 30, True, 0.7)
            assert memory.mode == EXPLORE
        policy(memory, preset, attention.look_interval, 0.2, 30, True, 0.7)
        assert memory.mode == CHASE


def test_it_goes_to_the_last_known_place_before_it_explores() -> None:
    memory, x = SeekerMemory.empty(), 0.3
    assert policy(memory, "expert", 0, x, 30, True, 0.6) == FORWARD
    for step in range(1, 60):
        x += 0.010
        primitive = policy(memory, "expert", step, x, 0, False, 0.0)
        if memory.mode == EXPLORE:
            break
        assert memory.mode == RECALL
        assert primitive == FORWARD
    assert memory.mode == EXPLORE
    assert x == pytest.approx(0.6, abs=0.035)


def test_a_refused_move_is_not_tried_again_but_a_late_command_is() -> None:
    memory = SeekerMemory.empty()
    assert policy(memory, "expert", 0, 0.3, 30, True, 0.8) == FORWARD
    assert policy(memory, "expert", 1, 0.3, 30, True, 0.8) != FORWARD
    core, table = seated(episode(seeker="expert", seed=2))
    said = command_of(answer(core, table.view()))
    while said.primitive != "forward":
        table.move("stay", said.primitive)
        said = command_of(answer(core, table.view()))
    core.step(Arrived("tick", Tick(stamp=1, episode=1, step=table.step, late=("seeker",))), 1)
    table.move("stay", "stay")
    assert command_of(answer(core, table.view())).primitive == "forward"


def test_reset_forgets_everything() -> None:
    memory, fresh = SeekerMemory.empty(), SeekerMemory.empty()
    for step in range(30):
        policy(memory, "glancing", step, 0.3, 30, True, 0.8)
    reset(memory)
    for kept, new in zip(memory[:4], fresh[:4], strict=True):
        assert (kept == new).all()
    replay = [policy(memory, "glancing", step, 0.3 + 0.01 * step, 0, False, 0.0) for step in range(50)]
    assert replay == [policy(fresh, "glancing", step, 0.3 + 0.01 * step, 0, False, 0.0) for step in range(50)]
