"""`vantage log verify` and process replay find what is wrong with a log: one spoilt message is enough."""

from collections.abc import Callable, Sequence
from dataclasses import replace as with_changes
from pathlib import Path

import pytest
from msgspec.structs import replace

from learning.collect import CollectSettings, play_block
from learning.process_replay import ProcessReplay, answers_as_heard, replay_service
from learning.verify import VerifySettings, check, check_game, main
from schemas import GOAL_COUNT, Command, Message, Plan, PredictReply, PredictRequest, Tick, encode
from services.simulator.core import SimulatorSettings
from tests.log.making import records_of, write_log, write_record
from vantage.log import LogWriter, Record, open_log, read
from vantage.log.episodes import EpisodeLog, episodes
from vantage.service import Answered, Ask, Changed, Declaration, Received, Send
from vantage.world.camera import Camera

Change = Callable[[Message], Message | None]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("verify") / "game.mcap"
    play_block(CollectSettings(hider="goal-walk", views=True, steps=40), range(3, 4), path)
    return path


def spoilt(log: Path, key: str, step: int, change: Change) -> Path:
    """A copy of a log in which one message is another one, or missing."""
    records: list[Record] = []
    for record in read(log):
        message: Message | None = record.decode()
        if record.key == key and message.step == step:  # type: ignore[union-attr]
            message = change(message)  # type: ignore[arg-type]
        if message is not None:
            records.append(replace(record, payload=encode(message)))
    path = log.with_name(f"spoilt-{len(list(log.parent.iterdir()))}.mcap")
    write_log(path, records)
    return path


def other_primitive(message: Message) -> Message:
    assert isinstance(message, Command)
    return replace(message, primitive="backward" if message.primitive != "backward" else "forward")


def wrong(game: EpisodeLog) -> list[str]:
    return [finding.what.partition(" ")[2] for finding in check_game(game) if finding.good is False]


def test_a_service_that_says_the_same_again_has_no_differences(log: Path) -> None:
    comparisons = {comparison.key: comparison for comparison in replay_service(log, "seeker")}
    assert [comparison.differences for comparison in comparisons.values()] == [[], []]
    assert comparisons["seeker/command"].compared == sum(1 for _ in read(log, topics=("seeker/command",))) > 5


def test_replay_names_the_message_and_the_field_that_differ(log: Path) -> None:
    found = {item.key: item.differences for item in replay_service(spoilt(log, "seeker/command", 4, other_primitive), "seeker")}
    assert found == {"seeker/command": ["message 4 (episode 3, step 4) differs in primitive"], "seeker/view": []}


def test_replay_finds_an_input_that_explains_another_output(log: Path) -> None:
    moved = spoilt(log, "seeker/pose", 4, lambda pose: replace(pose, heading=pose.heading + 1.0))  # type: ignore[attr-defined]
    found = {item.key: item.differences for item in replay_service(moved, "seeker")}
    assert "message 4 (episode 3, step 4) differs in data" in found["seeker/view"][0]


def test_replay_finds_a_message_that_is_missing(log: Path) -> None:
    found = {item.key: item.differences for item in replay_service(spoilt(log, "seeker/command", 4, lambda _: None), "seeker")}
    count = sum(1 for _ in read(log, topics=("seeker/command",)))
    assert found["seeker/command"][0] == f"{count - 1} messages recorded, {count} said again"


@pytest.mark.parametrize("robot", ["hider", "seeker"])
def test_a_missing_command_is_found_unless_the_robot_was_late(log: Path, robot: str) -> None:
    (game,) = episodes(read(log))
    assert wrong(game) == []
    (game,) = episodes(read(spoilt(log, f"{robot}/command", 4, lambda _: None)))
    assert wrong(game) == [f"3: one {robot} command a step"]
    game.late[4] = (robot,)  # type: ignore[assignment]
    assert wrong(game) == []


@pytest.mark.parametrize("caught", [1, 40, None])
def test_an_outcome_that_the_poses_do_not_have_is_found(log: Path, caught: int | None) -> None:
    (game,) = episodes(read(log))
    assert caught != game.episode.caught_step
    game.episode = replace(game.episode, outcome="survived" if caught is None else "caught", caught_step=caught)
    assert wrong(game) == ["3: outcome recomputed from the poses"]


def test_a_pose_that_is_missing_is_found(log: Path) -> None:
    (game,) = episodes(read(log))
    del game.depths["seeker"][2]
    assert wrong(game) == ["3 is whole"]


def test_a_value_map_wants_every_goal_and_a_choice_that_is_not_blocked(log: Path) -> None:
    (game,) = episodes(read(log))
    plan = game.plans[0]
    values = (None, *[1.0] * (GOAL_COUNT - 1))
    for changed, good in (
        (replace(plan, values=values, goal=1), True),
        (replace(plan, values=values, goal=0), False),
        (replace(plan, values=values, goal=None), False),
    ):
        game.plans[0] = changed
        assert wrong(game) == ([] if good else ["3: value map of step 0"])


def test_a_game_that_did_not_end_is_no_good(log: Path) -> None:
    (game,) = episodes(read(log))
    game.episode = replace(game.episode, phase="aborted", reason="no command from the hider for step 3")
    assert wrong(game) == ["3 ended"]


@pytest.mark.parametrize("reason", ["stopped on request", "another game was asked for", "discarded by the player"])
def test_a_game_that_somebody_stopped_is_neither_good_nor_bad(log: Path, reason: str) -> None:
    (game,) = episodes(read(log))
    game.episode = replace(game.episode, phase="aborted", reason=reason)
    (finding,) = check_game(game)
    assert (finding.good, finding.detail) == (None, f"aborted: {reason}")


@pytest.mark.parametrize("views", [True, False])
def test_a_collected_log_is_good_with_the_settings_it_was_made_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], views: bool
) -> None:
    made = CollectSettings(hider="random", seed=77, views=views, steps=30)
    camera = SimulatorSettings(Camera(width=40, height=12, horizontal_fov=1.1))
    path = tmp_path / "log.mcap"
    play_block(with_changes(made, world=camera), range(1, 4), path)
    assert main(VerifySettings(path)) == 0, capsys.readouterr().out
    shown = capsys.readouterr().out
    assert "NO" not in shown and "not recorded with" in shown and "hider/color by simulator" in shown
    compared = {found.key: found.compared for service in ("simulator", "referee") for found in replay_service(path, service)}
    assert compared["episode"] == 9 and compared["hider/pose"] == compared["tick"] + 3


@pytest.mark.parametrize("key", ["hider/command", "seeker/command", "hider/pose", "seeker/depth", "tick"])
def test_verify_says_no_with_its_exit_code(log: Path, capsys: pytest.CaptureFixture[str], key: str) -> None:
    assert main(VerifySettings(log)) == 0
    assert main(VerifySettings(spoilt(log, key, 4, lambda _: None))) == 1
    assert "NO" in capsys.readouterr().out


def test_replies_are_told_apart_where_several_ask_the_predictor() -> None:
    """The planner's question and another's, answered in the other order: each gets its own answer."""

    def request(paths: int) -> PredictRequest:
        return PredictRequest(
            stamp=5, state_image=bytes(128 * 128), path_count=paths, path_steps=2, paths=bytes(16 * paths), horizons=(1,)
        )

    core = Asking(request(3))
    replay = ProcessReplay(core)
    asked = [("predictor/request", request(paths)) for paths in (3, 1)]
    answered = [("predictor/reply", PredictReply(stamp=5, caught=bytes(4 * paths))) for paths in (1, 3)]
    for record in records_of([*asked, *answered]):
        replay.feed(record)
    assert [len(reply.caught) for reply in core.answers] == [12]


class Asking:
    """Asks one question at once, and keeps what comes back."""

    declaration = Declaration("planner", outputs=("hider/command",), calls=("predictor",), heeds=("predictor",))

    def __init__(self, question: PredictRequest) -> None:
        self._question = question
        self.answers: list[PredictReply] = []

    def wake_at(self) -> int | None:
        return None

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Answered) and isinstance(received.reply, PredictReply):
            self.answers.append(received.reply)
        return [Ask("predictor", self._question, 1.0, 1)] if isinstance(received, Changed) else ()


def test_the_planner_had_its_answer_before_the_predictor_told_everybody() -> None:
    """The predictor answers first and publishes the answer then; on a busy machine plan and next tick come between."""
    state = {"state_image": bytes(128 * 128), "path_count": 1, "path_steps": 2, "paths": bytes(16), "horizons": (1,)}
    question = PredictRequest(stamp=1, episode=1, **state)
    of_viewer = PredictRequest(stamp=1, episode=1, **state, views=((0, 0),))
    answer = PredictReply(stamp=1, episode=1, caught=bytes(4))
    to_viewer = replace(answer, views=(bytes(3 * 128 * 128),))
    said = [
        ("predictor/reply", to_viewer),  # of a question before
        ("predictor/request", question),
        ("predictor/request", of_viewer),
        ("predictor/reply", to_viewer),
        ("hider/plan", Plan(stamp=1, episode=1, horizon=2)),
        ("tick", Tick(stamp=2, episode=1, step=1)),
        ("predictor/reply", answer),
        ("tick", Tick(stamp=3, episode=1, step=2)),
        ("predictor/request", question),  # never answered
    ]
    records = [Record(key, "", place, place, place, encode(message)) for place, (key, message) in enumerate(said)]
    assert [record.sequence for record in answers_as_heard(records)] == [0, 1, 2, 3, 6, 4, 5, 7, 8]


def test_a_log_without_a_game_is_not_good(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with LogWriter(tmp_path / "empty.mcap", {}, sync=False):
        pass
    assert main(VerifySettings(tmp_path / "empty.mcap")) == 1
    assert "holds none" in capsys.readouterr().out


@pytest.mark.filterwarnings("error")
def test_a_damaged_log_is_not_good(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open_log(log) as whole:
        chunks = whole.files[0].chunks
    for chunk in (chunks[0], chunks[-1]):
        data = bytearray(log.read_bytes())
        data[chunk.offset + chunk.length // 2] ^= 0xFF
        (tmp_path / "damaged.mcap").write_bytes(data)
        assert main(VerifySettings(tmp_path / "damaged.mcap")) == 1
        shown = capsys.readouterr()
        assert "damaged chunk at byte" in shown.out and shown.err == ""


@pytest.mark.filterwarnings("error")
def test_a_log_that_is_not_closed_is_not_good(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open_log(log) as whole:
        last = max(chunk.offset + chunk.length for chunk in whole.files[0].chunks)
    (tmp_path / "cut.mcap").write_bytes(log.read_bytes()[:last])
    findings = check(tmp_path / "cut.mcap")
    wrong = [finding for finding in findings if finding.good is False]
    assert [finding.what for finding in wrong] == ["cut.mcap reads", "cut.mcap was closed"]
    assert "breaks off at" in wrong[0].detail and "vantage log recover" in wrong[1].detail
    assert main(VerifySettings(tmp_path / "cut.mcap")) == 1
    assert capsys.readouterr().err == ""


@pytest.mark.filterwarnings("error")
def test_a_log_that_is_being_recorded_is_not_finished(log: Path, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "live.mcap", {}, sync=False) as writer:
        for record in read(log):
            write_record(writer, record)
        writer.flush()
        wrong = [finding for finding in check(tmp_path / "live.mcap") if finding.good is False]
    assert [finding.what for finding in wrong] == ["live.mcap was closed"]
    assert "being recorded now" in wrong[0].detail


def test_what_takes_long_tells_how_far_it_is(log: Path) -> None:
    told: list[tuple[str, float]] = []
    check(log, lambda what, part: told.append((what, part)))
    assert list(dict.fromkeys(what for what, _ in told)) == ["reading every byte", "reading the games", "replaying the services"]
    assert all(0.0 <= part <= 1.0 for _, part in told) and {part for what, part in told if part == 1.0}
