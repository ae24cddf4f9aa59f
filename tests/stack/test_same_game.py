"""The same seed gives the same game: in one thread twice, and over Zenoh in separate processes; and its log explains itself."""

import json
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgpack
import numpy as np
import pytest
from mcap.reader import make_reader

from learning.in_process import play
from learning.process_replay import replay_service, replayable, without_clock
from learning.verify import VerifySettings, check_game
from learning.verify import main as verify
from schemas import TOPICS, Control, Message, Players, Rules
from services.planner.core import PlannerCore
from services.predictor.__main__ import make_core
from services.predictor.core import PredictorSettings
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore
from services.simulator.core import SimulatorCore, SimulatorSettings
from tests.stack.table import Table, follow
from vantage.bus.zenoh_bus import ZenohBus
from vantage.log import LogWriter
from vantage.log.episodes import episodes
from vantage.log.reader import read
from vantage.match import Match
from vantage.world.camera import Camera

SEED = 11
CAMERA = Camera(width=160, height=120)
IN_SIMULATION = {"simulator", "referee", "seeker", "planner", "predictor"}
GAME_TOPICS = tuple(
    key
    for key, topic in TOPICS.items()
    if not key.startswith("health/") and key != "control" and IN_SIMULATION.intersection(topic.publishers)
)
"""`control` is what people wish: a game in process needs no wish."""


def in_process_log(path: Path) -> Path:
    rules = Rules(step_period=0.0)
    settings = RefereeSettings(
        autoplay=True, games=1, seed=SEED, rules=rules, required=("simulator", "seeker", "planner", "predictor"), settle=0.0
    )
    cores = {
        "simulator": SimulatorCore(SimulatorSettings(camera=CAMERA)),
        "seeker": SeekerCore(),
        "planner": PlannerCore(),
        "predictor": make_core(PredictorSettings()),
        "referee": RefereeCore(settings),
    }
    with LogWriter(path, {}, sync=False) as writer:
        play(cores, 1, 1_000_000_000_000_000_000, writer)
    return path


def said(path: Path) -> dict[str, list[Message]]:
    """Return every topic's messages of a log, without stamps and times taken."""
    topics: dict[str, list[Message]] = {key: [] for key in GAME_TOPICS}
    for record in read(path):
        if record.key in topics:
            topics[record.key].append(without_clock(record.decode()))
    return topics


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return in_process_log(tmp_path_factory.mktemp("alone") / "game.mcap")


@dataclass(frozen=True)
class Played:
    """One game of separate processes over Zenoh: its whole log, and how the deployment ended.

    Attributes:
        down: outcome of `vantage down`.
        left: processes of the deployment that outlived it.
        status: outcome of `vantage status` afterwards.
    """

    log: Path
    down: subprocess.CompletedProcess[str]
    left: list[int]
    status: subprocess.CompletedProcess[str]


@pytest.fixture(scope="module")
def played() -> Iterator[Played]:
    with Table() as table:
        assert table.started.returncode == 0, table.started.stderr
        yield play_one(table)


def play_one(table: Table) -> Played:
    ask = Control(stamp=1, action="start", seed=SEED, games=1, rules=Rules(step_period=0.0), players=Players())
    with ZenohBus("command-line", table.folder) as bus:
        match = Match(bus, ask)
        follow(match, lambda: match.over, "one game")
    pids = [process.pid for process in table.deployment.processes() if process.pid]
    down = table.command("down")
    left = [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    (log,) = table.logs.glob("*.mcap")
    return Played(log, down, left, table.command("status"))


@pytest.fixture(scope="module")
def together(played: Played) -> Path:
    return played.log


def test_down_stops_everything(played: Played) -> None:
    assert played.down.returncode == 0, played.down.stderr
    assert "is down" in played.down.stdout
    assert not played.left
    assert played.status.returncode == 1


def test_in_process_twice(alone: Path, tmp_path: Path) -> None:
    again = said(in_process_log(tmp_path / "again.mcap"))
    first = said(alone)
    assert {key: len(messages) for key, messages in first.items()} == {key: len(messages) for key, messages in again.items()}
    assert first == again
    assert len(first["tick"]) > 5


def test_over_zenoh_in_separate_processes(alone: Path, together: Path) -> None:
    in_one_thread, in_processes = said(alone), said(together)
    for key in GAME_TOPICS:
        assert len(in_one_thread[key]) == len(in_processes[key]), key
        assert in_one_thread[key] == in_processes[key], key


@pytest.mark.parametrize("service", sorted(replayable()))
def test_each_service_alone_says_the_same_again(together: Path, service: str) -> None:
    comparisons = replay_service(together, service)
    assert comparisons
    for comparison in comparisons:
        assert comparison.differences == []
        assert comparison.compared > 0


def test_verify_finds_the_log_good(together: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify(VerifySettings(together)) == 0, capsys.readouterr().out


def test_the_outcome_follows_from_the_poses(together: Path) -> None:
    (game,) = episodes(read(together))
    assert all(finding.good for finding in check_game(game))


def test_the_log_reads_with_nothing_but_mcap_and_msgpack(together: Path) -> None:
    topics: dict[str, list[dict]] = {}
    sequences: dict[str, list[int]] = {}
    with together.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.topic.startswith("viewer/"):
                continue
            assert channel.message_encoding == "msgpack"
            assert schema is not None and schema.encoding == "jsonschema"
            properties = json.loads(schema.data)["properties"]
            content = msgpack.unpackb(message.data)
            assert set(content) <= set(properties)
            topics.setdefault(channel.topic, []).append(content)
            sequences.setdefault(channel.topic, []).append(message.sequence)
    deployed = {f"health/{name}" for name in ("simulator", "referee", "seeker", "planner", "predictor", "recorder")}
    assert set(topics) >= (set(GAME_TOPICS) | {"control"} | deployed)
    for topic, numbers in sequences.items():
        assert sorted(numbers) == list(range(min(numbers), min(numbers) + len(numbers))), f"gap in {topic}"
    steps = len(topics["tick"])
    for robot in ("hider", "seeker"):
        assert [message["step"] for message in topics[f"{robot}/command"]] == list(range(steps))
    values = topics["hider/plan"][0]["values"]
    assert len(values) == 121 and any(value is None for value in values) and any(value is not None for value in values)
    ended = topics["episode"][-1]
    hider, seeker = topics["hider/pose"], topics["seeker/pose"]
    distances = [np.hypot(a["x"] - b["x"], a["y"] - b["y"]) for a, b in zip(hider, seeker, strict=True)]
    caught = [step for step, distance in enumerate(distances) if distance <= 0.150 + 1e-9]
    assert ended["phase"] == "ended"
    assert ended["outcome"] == ("caught" if caught else "survived")
    assert ended["caught_step"] == (caught[0] if caught else None)
