"""The referee: step protocol, catch, lateness, stalled games, restarts."""

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from schemas import Command, Control, Episode, Health, Layout, Players, Pose, Rules, Tick
from services.referee.core import RefereeCore, RefereeSettings
from vantage.service import SECOND, Arrived, Changed, Publish, Send, Unexpected, Woken

REQUIRED = ("simulator", "seeker", "planner")


class Table:
    """Plays the other services' part by hand."""

    def __init__(self, **settings: object) -> None:
        self.core = RefereeCore(RefereeSettings(required=REQUIRED, **settings))  # type: ignore[arg-type]
        self.now = 0

    def send(self, received: object) -> list[object]:
        return messages(self.core.step(received, self.now))  # type: ignore[arg-type]

    def arrive(self) -> list[object]:
        self.wake()
        self.wake()
        sent: list[object] = []
        for name in REQUIRED:
            sent += self.send(Changed(name, True))
        return sent

    def wake(self) -> list[object]:
        wake = self.core.wake_at()
        assert wake is not None
        self.now = max(self.now, wake)
        return self.send(Woken())

    def pose(self, robot: str, x: float, step: int, episode: int = 1) -> list[object]:
        return self.send(Arrived(f"{robot}/pose", Pose(stamp=self.now, episode=episode, step=step, x=x, y=0.5, heading=0.0)))

    def ask(self, action: str, **wish: object) -> list[object]:
        return self.send(Arrived("control", Control(stamp=self.now, action=action, **wish)))  # type: ignore[arg-type]

    def console_says(self) -> list[object]:
        return self.send(trouble("console", "", "ok"))

    def command(self, robot: str, step: int, episode: int = 1) -> list[object]:
        command = Command(stamp=self.now, episode=episode, step=step, primitive="stay")
        return self.send(Arrived(f"{robot}/command", command))

    def play_step(self, step: int, hider: float, seeker: float) -> list[object]:
        self.command("hider", step)
        self.command("seeker", step)
        self.pose("hider", hider, step + 1)
        return self.pose("seeker", seeker, step + 1)


def messages(sends: Sequence[Send]) -> list[object]:
    assert all(isinstance(send, Publish) for send in sends)
    return [send.message for send in sends if isinstance(send, Publish)]


def start(**settings: object) -> Table:
    rules = settings.pop("rules", Rules(step_period=0.0))
    table = Table(autoplay=True, games=1, rules=rules, **settings)
    (setup,) = table.arrive()
    assert isinstance(setup, Episode) and setup.phase == "setup" and setup.seed == 1
    table.pose("hider", 0.2, 0)
    running, tick = table.pose("seeker", 0.6, 0)
    assert isinstance(running, Episode) and running.phase == "running"
    assert tick == Tick(stamp=table.now, episode=1, step=0)
    return table


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
    aborted, setup = table.send(Arrived("control", Control(stamp=0, action="start", seed=77)))
    assert isinstance(aborted, Episode) and isinstance(setup, Episode)
    assert aborted.phase == "aborted" and (setup.seed, setup.episode) == (77, 2)


def test_strangers_messages_are_set_aside() -> None:
    table = start()
    for robot in ("hider", "seeker"):
        with pytest.raises(Unexpected):
            table.pose(robot, 0.3, 7)
        with pytest.raises(Unexpected):
            table.command(robot, 0, episode=9)
        with pytest.raises(Unexpected):
            table.command(robot, 5)


def test_one_of_two_services_embodies_the_robots() -> None:
    for world in ("simulator", "tracker"):
        core = RefereeCore(RefereeSettings(autoplay=True, required=("simulator|tracker", "seeker"), settle=0.0))
        assert core.step(Woken(), 0) == () and core.step(Woken(), 0) == []
        assert messages(core.step(Changed("seeker", True), 0)) == []
        (setup,) = messages(core.step(Changed(world, True), 0))
        assert isinstance(setup, Episode)


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


def trouble(service: str, reason: str, state: str = "degraded") -> Arrived:
    health = Health(stamp=0, service=service, state=state, process=1, uptime=1.0, reason=reason)  # type: ignore[arg-type]
    return Arrived(f"health/{service}", health)


REAL = ("simulator|tracker", "simulator|robot|onboard", "seeker", "planner")


def aborted_at_the_first_step(*received: object) -> str:
    """Play up to step 0 on a real table, receive some events, and never see the next poses; return the reason."""
    table = Table(autoplay=True, games=1)
    table.core = RefereeCore(RefereeSettings(autoplay=True, games=1, rules=Rules(step_period=0.0), required=REAL))
    table.wake()
    table.wake()
    for name in ("tracker", "robot", "seeker", "planner"):
        table.send(Changed(name, True))
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    for event in received:
        table.send(event)
    table.command("hider", 0)
    table.command("seeker", 0)
    (aborted,) = table.wake()
    assert isinstance(aborted, Episode) and aborted.phase == "aborted" and aborted.outcome == "undecided"
    return aborted.reason


def test_an_aborted_game_says_what_those_who_embody_the_robots_complain_of() -> None:
    late = "step 0 was not executed within 3 s"
    assert aborted_at_the_first_step() == late
    lost = trouble("tracker", "overhead camera: no frame for 2.0 s")
    said = aborted_at_the_first_step(trouble("tracker", "no picture"), lost)
    assert said == f"{late}; tracker: overhead camera: no frame for 2.0 s"
    assert aborted_at_the_first_step(lost, trouble("tracker", "", "ok")) == late


def test_a_long_complaint_leaves_room_for_another() -> None:
    reason = aborted_at_the_first_step(trouble("tracker", "x" * 500), trouble("robot", "the seeker does not answer"))
    assert reason.endswith("xxx...; robot: the seeker does not answer") and len(reason) <= 200


def test_who_is_gone_is_named_and_its_last_words_are_not_believed() -> None:
    reason = aborted_at_the_first_step(trouble("robot", "all is well"), Changed("robot", False))
    assert reason == "step 0 was not executed within 3 s; simulator or robot or onboard is not alive"


def test_no_game_without_a_driver() -> None:
    core = RefereeCore(RefereeSettings(autoplay=True, required=REAL, settle=0.0))
    core.step(Woken(), 0)
    core.step(Woken(), 0)
    for name in ("tracker", "seeker", "planner"):
        assert messages(core.step(Changed(name, True), 0)) == []
    assert len(messages(core.step(Changed("robot", True), 0))) == 1


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


PACED = Rules(step_period=0.25)


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


HUMAN = Players(hider="human", person="Ada")


def test_a_human_plays_where_a_console_is_alive() -> None:
    table = Table()
    table.arrive()
    table.console_says()
    (setup,) = table.ask("start", players=HUMAN)
    assert isinstance(setup, Episode) and (setup.phase, setup.players) == ("setup", HUMAN)


def test_a_console_that_was_just_started_is_waited_for() -> None:
    table = Table()
    table.arrive()
    assert table.ask("start", players=HUMAN) == []
    table.now += 2 * SECOND
    (setup,) = table.console_says()
    assert isinstance(setup, Episode) and setup.phase == "setup"


@pytest.mark.parametrize(("hider", "seconds"), [("human", 5.0), ("nobody", 0.0)])
def test_a_game_that_nobody_drives_ends_soon_and_says_why(hider: str, seconds: float) -> None:
    table = Table()
    table.arrive()
    asked = table.now
    sent = table.ask("start", games=5, players=Players(hider=hider)) or table.wake()
    assert [(type(message), message.phase) for message in sent] == [(Episode, "setup"), (Episode, "aborted")]  # type: ignore[attr-defined]
    assert ("no console is alive" if hider == "human" else "`nobody`") in sent[1].reason  # type: ignore[attr-defined]
    assert table.now - asked == seconds * SECOND
    assert table.wake() == [] and table.core.wake_at() is None  # nor are the other four tried


def test_each_wish_waits_for_the_console_anew() -> None:
    table = Table()
    table.arrive()
    table.ask("start", players=HUMAN)
    table.now += 4 * SECOND
    table.ask("start", players=HUMAN)
    again = table.now
    _, aborted = table.wake()
    assert isinstance(aborted, Episode) and "no console" in aborted.reason and table.now == again + 5 * SECOND
    table.ask("start", players=HUMAN)
    table.now += SECOND
    table.send(Changed("planner", False))
    assert table.wake() == []  # it is the planner that is waited for now
    table.now += 60 * SECOND
    assert table.send(Changed("planner", True)) == []
    (setup,) = table.console_says()
    assert isinstance(setup, Episode) and setup.phase == "setup"


@pytest.mark.parametrize("rules", [Rules(step_period=0.0), PACED])
@pytest.mark.parametrize("step", [0, 1])
def test_a_human_whose_console_dies_is_not_waited_for(rules: Rules, step: int) -> None:
    table = Table()
    table.arrive()
    table.console_says()
    table.ask("start", players=HUMAN, rules=rules)
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    if step:
        table.play_step(0, 0.2, 0.6)
        if rules.step_period:
            table.wake()
    died = table.now
    sent: list[object] = []
    at = step
    while not any(isinstance(message, Episode) for message in sent):
        table.command("seeker", at)
        sent = table.wake()
        if sent and isinstance(sent[0], Tick):
            assert sent[0].late == ("hider",)
            table.pose("hider", 0.2, at + 1)
            table.pose("seeker", 0.6, at + 1)
            at += 1
    (aborted,) = sent
    assert isinstance(aborted, Episode) and "no console is alive" in aborted.reason
    assert table.now - died <= 7 * SECOND


def test_a_human_has_as_long_for_the_first_command_as_a_planner() -> None:
    table = Table()
    table.arrive()
    table.console_says()
    table.ask("start", players=HUMAN, rules=PACED)
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    began = table.now
    table.command("seeker", 0)
    while table.now < began + 29 * SECOND:
        table.console_says()
        assert table.wake() == []
    table.console_says()
    (aborted,) = table.wake()
    assert isinstance(aborted, Episode) and "no command from the hider for step 0" in aborted.reason
    assert table.now == began + 30 * SECOND


def test_a_service_of_the_name_hider_drives_what_it_is_asked_for() -> None:
    core = RefereeCore(RefereeSettings(autoplay=True, required=("hider",), players=Players(hider="goal-walk"), settle=0.0))
    core.step(Woken(), 0)
    core.step(Woken(), 0)
    (setup,) = messages(core.step(Changed("hider", True), 0))
    assert isinstance(setup, Episode) and setup.phase == "setup"


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
