"""What a human played: its log verifies, replays to the same game and from other starts; the person stays out of data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace as replace_settings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from learning.collect import CollectSettings, main, play_block
from learning.convert import convert
from learning.dataset import UnusableDataset
from learning.hiders.recorded import executed_primitives, read_trajectories
from learning.in_process import play
from learning.process_replay import replay_service
from learning.splits import split_of
from learning.verify import VerifySettings
from learning.verify import main as verify
from schemas import PRIMITIVES, Command, Control, Episode, Health, Message, Players, Pose, Rules, Tick, encode
from services.planner.core import PlannerCore
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore, SeekerSettings
from services.simulator.core import SimulatorCore
from tests.log.making import records_of, write_log
from vantage.errors import UserError
from vantage.log import LogWriter, Record, open_log, read
from vantage.log.episodes import EpisodeLog, episodes, games_of
from vantage.service import SECOND, Arrived, Core, Declaration, Publish, Received, Send, Woken
from vantage.world.arena import CATCH_TOLERANCE

PERSON = "Ada Lovelace"
STEPS = 25
GAMES = 6
DISCARDED = {1: 5, 2: 2, 4: 4}
"""Game -> the game during or after which it is discarded; 4 while it is being played."""
KEPT = (3, 5, 6)
SEED = next(seed for seed in range(1, 10_000) if {split_of(seed + number - 1) for number in KEPT} == {0, 1, 2})


@dataclass
class Player:
    """A human at the console: mostly in time, at times too late or not there, pauses, and takes games back.

    Attributes:
        seed: of what they do.
        lateness: how often the command does not come in time.
    """

    seed: int
    start: Control
    lateness: float = 0.2
    pauses: float = 0.1

    declaration = Declaration("console", inputs=("episode", "tick"), outputs=("control", "hider/command"))

    def __post_init__(self) -> None:
        self._generator = np.random.default_rng(self.seed)
        self._due: list[tuple[int, str, Message]] = []
        self._asked = False

    def wake_at(self) -> int | None:
        return min((due[0] for due in self._due), default=None if self._asked else 0)

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Woken):
            if not self._asked:
                self._asked = True
                return (Publish("control", replace(self.start, stamp=now)),)
            due = [entry for entry in self._due if entry[0] <= now]
            self._due = [entry for entry in self._due if entry[0] > now]
            return [Publish(key, message) for _, key, message in due]
        if not isinstance(received, Arrived):
            return ()
        message = received.message
        if isinstance(message, Tick) and not message.late:
            self._play(message, now)
        elif isinstance(message, Episode) and message.phase == "ended":
            for number in (number for number, after in DISCARDED.items() if after == message.episode):
                self._do(now, "control", Control(stamp=now, episode=number, action="discard"))
        return ()

    def _do(self, when: int, key: str, message: Message) -> None:
        self._due.append((when, key, message))

    def _play(self, tick: Tick, now: int) -> None:
        if tick.episode in DISCARDED and DISCARDED[tick.episode] == tick.episode and tick.episode != 2 and tick.step == 3:
            self._do(now, "control", Control(stamp=now, episode=tick.episode, action="discard"))
            return
        chance, pausing = self._generator.random(2)
        primitive = PRIMITIVES[int(self._generator.choice(5, p=[0.1, 0.4, 0.1, 0.2, 0.2]))]
        # No game starts without the first command; a late one comes when the step is over.
        delay = 1.5 if tick.step and chance < self.lateness else 0.1 * self._generator.random()
        if pausing < self.pauses:
            self._do(now, "control", Control(stamp=now, action="pause"))
            self._do(now + 600 * SECOND, "control", Control(stamp=now, action="resume"))
        command = Command(stamp=now, episode=tick.episode, step=tick.step, primitive=primitive)
        self._do(now + int(delay * SECOND), "hider/command", command)


def record_games(path: Path, seed: int = SEED, games: int = GAMES, lateness: float = 0.2, catching: bool = True) -> Path:
    """Have a human play some games of STEPS steps into a log, at a real referee and in a real world."""
    rules = Rules(maximum_steps=STEPS, catching=catching)
    players = Players(hider="human", person=PERSON)
    start = Control(stamp=0, action="start", seed=seed, games=games, rules=rules, players=players)
    cores: dict[str, Core] = {
        "simulator": SimulatorCore(),
        "seeker": SeekerCore(SeekerSettings(publish_view=False)),
        "planner": PlannerCore(),
        "console": Player(seed, start, lateness),
        "referee": RefereeCore(RefereeSettings(required=("simulator", "seeker", "planner", "console"), settle=0.0)),
    }
    with LogWriter(path, {}, sync=False) as writer:
        play(cores, games, 1_800_000_000_000_000_000, writer)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_games(tmp_path_factory.mktemp("human") / "games.mcap")


def games_in(path: Path) -> list[EpisodeLog]:
    with open_log(path) as log:
        return list(games_of(log))


def changed(log: Path, name: str, *added: Record, key: str = "", place: tuple[int, int] = (0, 0), primitive: str = "") -> Path:
    """A copy of a log with other records beside its own, or with another command in one place."""
    records = [
        replace(record, payload=encode(replace(message, primitive=primitive)))
        if record.key == key and (message.episode, message.step) == place
        else record
        for record in read(log)
        for message in [record.decode()]
    ]
    write_log(path := log.with_name(name), [*added, *records])
    return path


def test_the_log_is_of_a_human_who_was_late_paused_and_took_games_back(log: Path) -> None:
    found = games_in(log)
    assert [game.number for game in found] == list(range(1, GAMES + 1))
    assert {(game.episode.players.hider, game.episode.players.person) for game in found} == {("human", PERSON)}
    assert {game.number for game in found if game.discarded} == set(DISCARDED)
    assert [game.number for game in found if game.complete] == list(KEPT)
    assert [game.number for game in found if game.episode.phase == "aborted"] == [4]
    assert sum(len(game.late) for game in found) > 3
    assert any(isinstance(message, Episode) and message.paused for message in (record.decode() for record in read(log)))


def test_it_verifies_and_is_played_again_to_the_same_game(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify(VerifySettings(log)) == 0, capsys.readouterr().out
    poses = {f"{robot}/pose": sum(1 for _ in read(log, topics=(f"{robot}/pose",))) for robot in ("hider", "seeker")}
    compared = {comparison.key: (comparison.compared, comparison.differences) for comparison in replay_service(log, "simulator")}
    assert {key: compared[key] for key in poses} == {key: (count, []) for key, count in poses.items()}
    shown = " ".join(capsys.readouterr().out.split())
    assert "NO" not in shown and "human" in shown and PERSON not in shown
    assert replay_service(log, "planner") == []


@pytest.mark.parametrize("health", [False, True])
def test_a_planner_that_had_no_game_is_not_blamed(log: Path, capsys: pytest.CaptureFixture[str], health: bool) -> None:
    said = Health(stamp=1, service="planner", state="ok", process=1, uptime=1.0)
    beside = [Record("health/planner", "planner", 0, 1, 1, encode(said))] if health else []
    assert verify(VerifySettings(changed(log, f"health-{health}.mcap", *beside))) == 0
    shown = capsys.readouterr().out
    assert ("no game of its own" in shown) == health and ("not recorded with" in shown) != health


def test_a_pause_may_be_on_its_way_while_the_referee_ticks(log: Path) -> None:
    """By the publishers' clock it comes before a tick that the referee gave before it heard of the pause."""
    records = list(read(log))
    ticks = [record.publish_time for record in records if record.key == "tick"]
    moved = 0
    for index, record in enumerate(records):
        message = record.decode()
        if isinstance(message, Control) and message.action == "pause":
            before = max(time for time in ticks if time <= record.publish_time)
            records[index] = replace(record, publish_time=before - 1)
            moved += 1
    assert moved > 3
    write_log(path := log.with_name("on-its-way.mcap"), records)
    assert [found.differences for found in replay_service(path, "referee")] == [[], []]
    assert verify(VerifySettings(path)) == 0


def test_another_command_in_the_log_makes_another_game(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    game = games_in(log)[KEPT[0] - 1]
    step = next(
        step
        for step in range(2, game.steps)
        if step not in game.late and game.commands["hider"][step].primitive in ("left", "right")
    )
    spoilt = changed(log, "spoilt.mcap", key="hider/command", place=(game.number, step), primitive="backward")
    differences = {found.key: found.differences for found in replay_service(spoilt, "simulator")}
    place = f"(episode {game.number}, step {step + 1})"
    assert place in differences["hider/pose"][0] and not differences["layout"]
    assert verify(VerifySettings(spoilt)) == 1
    assert "NO" in capsys.readouterr().out


def poses_from(game: EpisodeLog, primitives: NDArray[np.int64]) -> list[Pose]:
    """The hider's poses [steps + 1] when it does these primitives in time, and the seeker what it did."""
    world = SimulatorCore()
    sends = [*world.step(Arrived("episode", replace(game.episode, phase="setup")), 0)]
    for step, primitive in enumerate(primitives.tolist()):
        command = Command(stamp=0, episode=game.number, step=step, primitive=PRIMITIVES[primitive])
        for key, message in (("hider/command", command), ("seeker/command", game.commands["seeker"][step])):
            sends += world.step(Arrived(key, message), 0)
    said = [send.message for send in sends if isinstance(send, Publish) and send.key == "hider/pose"]
    return [message for message in said if isinstance(message, Pose)]


@given(st.integers(1, 10_000), st.floats(0.0, 0.9))
@settings(max_examples=8)
def test_what_is_replayed_is_what_was_done(tmp_path_factory: pytest.TempPathFactory, seed: int, lateness: float) -> None:
    """Brute force: the primitives that are read, done in time, lead along the very poses of the log."""
    path = record_games(tmp_path_factory.mktemp("done") / "log.mcap", seed, 1, lateness, catching=False)
    (game,) = episodes(read(path))
    primitives = executed_primitives(game)
    assert primitives is not None and len(primitives) == game.steps == STEPS
    places = [(pose.step, pose.x, pose.y, pose.heading) for pose in poses_from(game, primitives)]
    assert places == [(pose.step, pose.x, pose.y, pose.heading) for pose in game.poses["hider"].values()]


def test_only_games_that_count_are_read_and_it_is_said_whose(log: Path) -> None:
    found = read_trajectories(log.parent / log.name, "human")
    assert [len(split) for split in found.by_split] == [1, 1, 1]
    assert (dict(found.drivers), dict(found.left_out)) == ({"human": 3}, {"discarded by the player": 3})
    assert str(found) == "3 trajectories, 3 of human (1 train, 1 validation, 1 test); left out: 3 discarded by the player"
    by_number = {game.number: game for game in games_in(log)}
    for number in KEPT:
        game = by_number[number]
        primitives = executed_primitives(game)
        assert primitives is not None
        (read_in,) = found.by_split[split_of(game.episode.seed)]
        np.testing.assert_array_equal(read_in, primitives)
        for step, late in game.late.items():
            assert "hider" in late and primitives[step] == PRIMITIVES.index("stay")


def test_a_game_that_lacks_a_command_is_left_out(log: Path) -> None:
    (game,) = [game for game in games_in(log) if game.number == KEPT[0]]
    step = next(step for step in range(game.steps) if step not in game.late)
    del game.commands["hider"][step]
    assert executed_primitives(game) is None
    game.late[step] = ("seeker",)
    assert executed_primitives(game) is None
    game.late[step] = ("hider",)
    assert executed_primitives(game) is not None


def test_human_trajectories_are_replayed_from_other_starts(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    (folder / "table.mcap").write_bytes(log.read_bytes())
    others = CollectSettings(games=12, hider="random", to=folder / "others", workers=1, steps=STEPS)
    assert main(others) == 0
    replayed = replace_settings(others, hider="replay", to=tmp_path / "replayed", source=folder, driver="human", seed=500)
    assert main(replayed) == 0
    assert (
        "3 trajectories, 3 of human (1 train, 1 validation, 1 test); left out: 3 discarded by the player, 12 driven by random"
        in (capsys.readouterr().out)
    )
    human = read_trajectories(log, "human").by_split
    (made,) = sorted((tmp_path / "replayed").glob("*.mcap"))
    for game in games_in(made):
        (trajectory,) = human[split_of(game.episode.seed)]
        expected = np.zeros(game.steps, np.int64)
        expected[: len(trajectory)] = trajectory[: game.steps]
        primitives = executed_primitives(game)
        assert primitives is not None
        np.testing.assert_array_equal(primitives, expected)
        assert game.episode.players == Players(hider="replay")
    assert PERSON.encode() not in made.read_bytes()
    with pytest.raises(UserError, match=r"holds no hider trajectory that `scripted` drove.*driven by random"):
        main(replace_settings(replayed, driver="scripted", to=tmp_path / "none"))
    with pytest.raises(UserError, match="no log"):
        main(replace_settings(replayed, source=tmp_path / "nowhere"))


def test_discarded_games_and_names_stay_out_of_training_sets(log: Path, tmp_path: Path) -> None:
    play_block(CollectSettings(hider="goal-walk", seed=900, steps=STEPS), range(1, 4), tmp_path / "made.mcap")
    manifest = convert([log, tmp_path / "made.mcap"], tmp_path / "dataset", workers=1, quiet=True)
    assert manifest["hiders"] == {"goal-walk": 3}
    assert manifest["left_out"] == {"discarded by the player": 3, "no planned path": 3}
    for path in (tmp_path / "dataset").iterdir():
        assert PERSON.encode() not in path.read_bytes(), path
    with pytest.raises(UnusableDataset, match="3 discarded by the player"):
        convert([log], tmp_path / "none", workers=1, quiet=True)


def test_a_game_that_could_serve_is_left_out_only_because_it_was_discarded(tmp_path: Path) -> None:
    path = tmp_path / "made.mcap"
    play_block(CollectSettings(hider="goal-walk", seed=900, steps=STEPS), range(1, 5), path)
    records = list(read(path))
    wish = Control(stamp=1, episode=900, action="discard")
    last = records[-1].log_time
    write_log(tmp_path / "discarded.mcap", [*records, Record("control", "console", 0, last + 1, last + 1, encode(wish))])
    whole = convert([path], tmp_path / "whole", workers=1, quiet=True)
    fewer = convert([tmp_path / "discarded.mcap"], tmp_path / "fewer", workers=1, quiet=True)
    assert sum(whole["episodes"].values()) - sum(fewer["episodes"].values()) == 1  # type: ignore[attr-defined]
    assert fewer["left_out"] == {"discarded by the player": 1}


def test_the_catch_of_a_human_game_follows_from_its_poses(log: Path) -> None:
    ended = [game for game in games_in(log) if game.episode.phase == "ended"]
    for game in ended:
        distances = [
            np.hypot(
                game.poses["hider"][step].x - game.poses["seeker"][step].x,
                game.poses["hider"][step].y - game.poses["seeker"][step].y,
            )
            for step in range(1, game.steps + 1)
        ]
        near = [step for step, distance in enumerate(distances, 1) if distance <= 0.150 + CATCH_TOLERANCE]
        assert near == ([] if game.episode.caught_step is None else [game.episode.caught_step])


def test_games_of_which_only_the_end_is_on_the_log_are_no_trajectories(tmp_path: Path) -> None:
    """A recorder that was started again gets the last words on earlier games from the publishers' caches, and no steps."""
    players = Players(hider="human")
    words = [
        Episode(stamp=stamp, episode=1, seed=3, phase=phase, step=step, players=players, outcome="survived")
        for stamp, (phase, step) in enumerate((("setup", 0), ("running", 0), ("ended", 9)))
    ]
    path = tmp_path / "run.mcap"
    write_log(path, records_of([("episode", word) for word in words]))
    found = read_trajectories(path, "human")
    assert not any(found.by_split)
    assert found.left_out == {"not recorded whole": 1}
