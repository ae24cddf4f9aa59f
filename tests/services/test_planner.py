"""The planner: value map, choice of the goal, controller, retries. The predictor's part is played by rules of the test."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from schemas import (
    GOAL_COUNT,
    PRIMITIVES,
    Command,
    Episode,
    Intrinsics,
    Layout,
    Plan,
    Players,
    Pose,
    PredictReply,
    PredictRequest,
    Rules,
    StateImage,
    Tick,
)
from services.planner.controller import Controller
from services.planner.core import PlannerCore, PlannerSettings
from services.planner.value_map import checkpoints, choose_goal, values_of
from services.simulator.core import SimulatorCore
from vantage.perception.seen_map import blocked, occupancy_of
from vantage.perception.state_image import Perceived
from vantage.service import Answered, Arrived, Ask, Publish, Send, Unexpected, Woken
from vantage.world import search
from vantage.world.arena import GOALS
from vantage.world.layout import boxes_of
from vantage.world.motion import apply_primitive

Judge = Callable[[NDArray[np.float32], tuple[int, ...]], NDArray[np.float32]]


def far_from_the_origin(paths: NDArray[np.float32], horizons: tuple[int, ...]) -> NDArray[np.float32]:
    """Pretend that the corner (0, 0) is dangerous: probability falls with the distance at each checkpoint."""
    distances = np.linalg.norm(paths[:, list(horizons)], axis=2)
    return np.clip(1.0 - distances / 1.7, 0.0, 1.0).astype(np.float32)


class Play:
    """A planner core with a real simulator core; the seeker stays where it is."""

    def __init__(self, settings: PlannerSettings | None = None, seed: int = 3, layout: str = "random", steps: int = 60) -> None:
        self.planner = PlannerCore(settings)
        self.simulator = SimulatorCore()
        self.rules = Rules(maximum_steps=steps, step_period=0.0, layout=layout)
        self.plans: list[Plan] = []
        self.commands: list[Command] = []
        self.views: list[StateImage] = []
        self.asked: list[PredictRequest] = []
        self.poses: list[tuple[float, float]] = []
        setup = Episode(stamp=1, episode=1, seed=seed, phase="setup", rules=self.rules)
        world = self.simulator.step(Arrived("episode", setup), 5)
        self.planner.step(Arrived("episode", setup), 5)
        self.pending = self.show(world, 0)

    def show(self, world: Sequence[Send], step: int) -> list[Send]:
        sends: list[Send] = []
        for send in world:
            assert isinstance(send, Publish)
            if send.key == "hider/pose":
                self.poses.append((send.message.x, send.message.y))  # type: ignore[attr-defined]
            if send.key in self.planner.declaration.inputs:
                sends += self.planner.step(Arrived(send.key, send.message), 5)
        sends += self.planner.step(Arrived("tick", Tick(stamp=5, episode=1, step=step)), 5)
        return sends

    def take(self, sends: Sequence[Send]) -> list[Ask]:
        asks = []
        for send in sends:
            if isinstance(send, Ask):
                assert isinstance(send.request, PredictRequest)
                self.asked.append(send.request)
                asks.append(send)
            elif isinstance(send, Publish):
                kind: dict[type, list] = {Plan: self.plans, Command: self.commands, StateImage: self.views}
                kind[type(send.message)].append(send.message)
        return asks

    def answer(self, ask: Ask, judge: Judge) -> Sequence[Send]:
        request = ask.request
        assert isinstance(request, PredictRequest)
        paths = np.frombuffer(request.paths, np.float32).reshape(request.path_count, request.path_steps, 2)
        caught = judge(paths, request.horizons)
        return self.planner.step(Answered("predictor", ask.token, PredictReply(stamp=5, caught=caught.tobytes())), 5)

    def run(self, judge: Judge = far_from_the_origin) -> None:
        (ask,) = self.take(self.pending)
        self.take(self.answer(ask, judge))
        for step in range(self.rules.maximum_steps - 1):
            self.simulator.step(Arrived("hider/command", self.commands[-1]), 5)
            stay = Command(stamp=5, episode=1, step=step, primitive="stay")
            self.take(self.show(self.simulator.step(Arrived("seeker/command", stay), 5), step + 1))


def test_it_asks_once_about_every_open_goal_and_drives_to_the_safest() -> None:
    play = Play(steps=200)
    play.run()
    (request,) = play.asked
    plan = play.plans[0]
    open_goals = [goal for goal, value in enumerate(plan.values) if value is not None]
    assert request.path_count == len(open_goals) > 60
    assert request.horizons == tuple(range(9, 200, 10))
    assert plan.goal == min(open_goals, key=lambda goal: plan.values[goal])  # type: ignore[arg-type,return-value]
    assert np.linalg.norm(GOALS[plan.goal]) > 1.2, "with a dangerous origin the far corner is safest"
    assert math.dist(play.poses[-1], GOALS[plan.goal]) < 0.02
    assert [command.step for command in play.commands] == list(range(200))


def test_play_follows_the_plan_exactly_where_nothing_is_in_the_way() -> None:
    play = Play(seed=4, layout="lab", steps=60)
    play.run()
    starts = [*(plan.step for plan in play.plans), 60]
    for plan, end in zip(play.plans, starts[1:], strict=True):
        planned = np.frombuffer(plan.path, np.float32).reshape(-1, 3)
        for step in range(plan.step, end):
            assert planned[step - plan.step, :2] == pytest.approx(play.poses[step], abs=1e-5)


def test_every_message_carries_the_stamp_of_the_picture() -> None:
    play = Play()
    play.run()
    assert {message.stamp for message in [*play.commands, *play.views, *play.plans]} == {5}


def test_a_predictor_that_fails_is_asked_again() -> None:
    play = Play()
    (ask,) = play.take(play.pending)
    with pytest.raises(Unexpected, match="nobody"):
        play.planner.step(Answered("predictor", ask.token, None, "nobody serves it"), 10)
    wake = play.planner.wake_at()
    assert wake is not None and wake > 10
    (again,) = play.take(play.planner.step(Woken(), wake))
    play.take(play.answer(again, far_from_the_origin))
    assert len(play.plans) == 1 and len(play.commands) == 1


def test_a_late_answer_to_an_earlier_question_is_not_taken_for_the_one_under_way() -> None:
    play = Play()
    (ask,) = play.take(play.pending)
    with pytest.raises(Unexpected, match="too slow"):
        play.planner.step(Answered("predictor", ask.token, None, "too slow"), 10)
    wake = play.planner.wake_at()
    assert wake is not None
    (again,) = play.take(play.planner.step(Woken(), wake))
    assert again.token != ask.token
    assert play.answer(ask, far_from_the_origin) == ()
    play.take(play.answer(again, far_from_the_origin))
    assert play.answer(again, far_from_the_origin) == ()
    assert len(play.plans) == 1 and len(play.commands) == 1


def test_a_reply_of_the_wrong_size_is_set_aside_and_asked_again() -> None:
    play = Play()
    (ask,) = play.take(play.pending)
    with pytest.raises(Unexpected, match="answered 1 probabilities"):
        play.planner.step(Answered("predictor", ask.token, PredictReply(stamp=1, caught=bytes(4))), 10)
    assert play.planner.wake_at() is not None


def test_it_plans_from_the_step_at_which_it_was_started() -> None:
    play = Play(steps=60)
    play.run()
    late = PlannerCore()
    running = Episode(stamp=1, episode=1, seed=3, phase="running", rules=play.rules)
    assert late.step(Arrived("episode", running), 5) == ()
    world = SimulatorCore().step(Arrived("episode", Episode(stamp=1, episode=1, seed=3, phase="setup", rules=play.rules)), 5)
    sends: list[Send] = []
    for send in world:
        if isinstance(send, Publish) and send.key in late.declaration.inputs:
            message = send.message if send.key == "layout" else _at_step(send.message, 30)
            sends += late.step(Arrived(send.key, message), 5)
    sends += late.step(Arrived("tick", Tick(stamp=5, episode=1, step=30)), 5)
    (ask,) = [send for send in sends if isinstance(send, Ask)]
    assert isinstance(ask.request, PredictRequest)
    assert ask.request.path_steps == 30 and ask.request.horizons == (9, 19, 29)


def _at_step(message, step):  # type: ignore[no-untyped-def]
    return replace(message, step=step)


def test_the_privileged_map_blocks_goals_that_the_camera_cannot_know() -> None:
    seen, privileged = Play(seed=9), Play(PlannerSettings(map="privileged"), seed=9)
    seen.run()
    privileged.run()
    blocked = [{goal for goal, value in enumerate(play.plans[0].values) if value is None} for play in (seen, privileged)]
    assert len(blocked[1]) > len(blocked[0])


def test_a_goal_where_the_robot_cannot_stand_is_blocked_even_right_beside_it() -> None:
    # From within the clearance of a box a path may lead out over blocked cells, and so to a blocked goal close by.
    setup = Episode(stamp=1, episode=1, seed=3, phase="setup", rules=Rules(maximum_steps=20, step_period=0.0, layout="random"))
    world = [send for send in SimulatorCore().step(Arrived("episode", setup), 5) if isinstance(send, Publish)]
    (layout,) = [send.message for send in world if isinstance(send.message, Layout)]
    cells = blocked(occupancy_of(boxes_of(layout)), search.CLEARANCE)
    goals = [goal for goal, (x, y) in enumerate(GOALS.tolist()) if cells[search.cell_of(y), search.cell_of(x)]]
    told = 0
    for goal in goals:
        planner = PlannerCore(PlannerSettings(map="privileged"))
        planner.step(Arrived("episode", setup), 5)
        for send in world:
            if send.key in planner.declaration.inputs:
                message = send.message
                if isinstance(message, Pose):
                    message = replace(message, x=GOALS[goal, 0] + 0.03, y=GOALS[goal, 1])
                planner.step(Arrived(send.key, message), 5)
        ask = planner.step(Arrived("tick", Tick(stamp=5, episode=1, step=0)), 5)[-1]
        assert isinstance(ask, Ask) and isinstance(ask.request, PredictRequest)
        reply = PredictReply(stamp=5, caught=bytes(4 * ask.request.path_count * len(ask.request.horizons)))
        plan = planner.step(Answered("predictor", ask.token, reply), 5)[0]
        assert isinstance(plan, Publish) and isinstance(plan.message, Plan)
        if ask.request.path_count > 1:  # else there is no way out, and the hider proposes to stay
            told += 1
            assert all(plan.message.values[other] is None for other in goals), f"beside goal {goal}"
    assert told > 3


def nothing_seen() -> Perceived:
    camera = Intrinsics(fx=1.0, fy=1.0, cx=0.0, cy=0.0, mount_height=0.1)
    return Perceived(np.empty((0, 0), np.uint8), np.full(1, np.nan), np.zeros(1, np.uint8), None, 0, False, camera)


@pytest.mark.parametrize("heading", [0, 18])
def test_a_refused_move_is_remembered_and_driven_around(heading: int) -> None:
    controller = Controller(np.zeros((search.CELLS, search.CELLS), np.uint8))  # a box that no camera shows stands in the middle
    box = np.array([[0.6, 0.6, 0.05, 0.05, 1.0, 0.0, 0.2]])
    x, y = 0.25, 0.6
    controller.go_to(0.95, 0.6, x, y, heading)
    changes = 0
    for step in range(400):
        controller.observe(nothing_seen(), x, y, heading, step)
        primitive = controller.drive(x, y, heading)
        if controller.path_changed:
            changes += 1
            controller.planned_path(x, y, heading, 1)
        x, y, heading, _ = apply_primitive(box, 1.2, 1.2, x, y, heading, primitive, math.nan, math.nan)
    assert math.dist((x, y), (0.95, 0.6)) < 0.02
    assert changes > 1


def test_a_command_that_came_late_is_no_obstacle() -> None:
    play = Play(seed=4, layout="lab", steps=60)
    (ask,) = play.take(play.pending)
    play.take(play.answer(ask, far_from_the_origin))
    for step in range(12):  # every command comes too late, the robot never moves
        play.planner.step(Arrived("tick", Tick(stamp=5, episode=1, step=step, late=("hider",))), 5)
        world = play.simulator.step(Arrived("tick", Tick(stamp=5, episode=1, step=step, late=("hider", "seeker"))), 5)
        play.take(play.show(world, step + 1))
    assert len(play.plans) == 1, "nothing was bumped into, so the path stays"


def test_a_long_game_is_planned_as_far_as_f_and_t_reach() -> None:
    play = Play(steps=5000)
    (ask,) = play.take(play.pending)
    assert isinstance(ask.request, PredictRequest)
    assert ask.request.path_steps == 400 and len(ask.request.horizons) == 40
    play.take(play.answer(ask, far_from_the_origin))
    assert play.plans[0].horizon == 400


def test_settings_without_sense_are_refused_at_the_start() -> None:
    with pytest.raises(ValueError, match="checkpoint-interval"):
        PlannerCore(PlannerSettings(checkpoint_interval=0))


def test_it_leaves_episodes_of_other_hiders_alone() -> None:
    """Silently: they are not its game. Also after one of its own, and before the next."""
    play = Play(steps=5)
    play.run()
    driven = len(play.commands)
    assert driven == 5
    for phase in ("setup", "running"):
        episode = Episode(stamp=1, episode=2, seed=3, phase=phase, rules=play.rules, players=Players(hider="human"))
        assert play.planner.step(Arrived("episode", episode), 6) == ()
    world = play.simulator.step(Arrived("episode", replace(episode, phase="setup")), 6)
    for send in world:
        assert isinstance(send, Publish)
        if send.key in play.planner.declaration.inputs:
            assert play.planner.step(Arrived(send.key, send.message), 6) == ()
    assert play.planner.step(Arrived("tick", Tick(stamp=6, episode=2, step=0)), 6) == ()
    play.planner.step(Arrived("episode", replace(episode, phase="ended")), 7)
    own = Episode(stamp=8, episode=3, seed=3, phase="setup", rules=play.rules)
    sends: list[Send] = list(play.planner.step(Arrived("episode", own), 8))
    for send in play.simulator.step(Arrived("episode", own), 8):
        assert isinstance(send, Publish)
        if send.key in play.planner.declaration.inputs:
            sends += play.planner.step(Arrived(send.key, send.message), 8)
    sends += play.planner.step(Arrived("tick", Tick(stamp=8, episode=3, step=0)), 8)
    assert [type(send) for send in sends] == [Publish, Ask]


def test_commands_are_primitives_of_the_table() -> None:
    play = Play()
    play.run()
    assert {command.primitive for command in play.commands} <= set(PRIMITIVES)
    assert len({command.primitive for command in play.commands}) > 1


@pytest.mark.parametrize(("horizon", "count"), [(100, 10), (200, 20), (5, 0), (10, 1), (99, 9)])
def test_checkpoints_are_those_of_the_paper(horizon: int, count: int) -> None:
    steps = checkpoints(horizon, 10)
    assert len(steps) == count
    assert all(step == 10 * k - 1 for k, step in enumerate(steps, start=1))


def test_binary_values_count_and_expected_values_add() -> None:
    caught = np.array([[0.1, 0.6, 0.9], [0.5, 0.5, 0.5]], np.float32)
    assert values_of(caught, "binary").tolist() == [2.0, 3.0]
    assert values_of(caught, "expected") == pytest.approx([1.6, 1.5])


@settings(deadline=None)
@given(st.lists(st.integers(0, 4), min_size=GOAL_COUNT, max_size=GOAL_COUNT), st.floats(0, 1.2), st.floats(0, 1.2))
def test_ties_go_to_the_goal_farthest_from_the_hider(values: list[int], x: float, y: float) -> None:
    array = np.array(values, float)
    array[::7] = np.nan
    goal = choose_goal(array, x, y)
    best = [other for other in range(GOAL_COUNT) if array[other] == np.nanmin(array)]
    assert goal in best
    assert math.dist((x, y), GOALS[goal]) == pytest.approx(max(math.dist((x, y), GOALS[other]) for other in best))


def test_all_goals_blocked_is_a_clear_error() -> None:
    with pytest.raises(ValueError, match="nowhere to go"):
        choose_goal(np.full(GOAL_COUNT, np.nan), 0.5, 0.5)
    assert len(GOALS) == GOAL_COUNT
