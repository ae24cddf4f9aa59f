"""A recorded log on a real bus: services work on it as if it were live, and it does what it is told."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from learning.in_process import play
from learning.process_replay import without_clock
from schemas import Control, Episode, Health, Message, Playback, Rules, Tick
from services.planner.core import PlannerCore
from services.predictor.__main__ import make_core
from services.predictor.core import PredictorSettings
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore
from services.simulator.core import SimulatorCore, SimulatorSettings
from tests.stack.table import PATIENCE, VANTAGE, wait
from vantage.bus import Sample
from vantage.bus.zenoh_bus import ZenohBus
from vantage.log import LogWriter
from vantage.log.reader import read
from vantage.world.camera import Camera

STEPS = 16
GAMES = 2
QUICK = 10.0
WATCHED = ("playback", "episode", "tick", "hider/pose", "hider/plan", "hider/command", "health/planner")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two games with the planner, at four steps a second of a virtual clock."""
    path = tmp_path_factory.mktemp("log") / "games.mcap"
    rules = Rules(step_period=0.25, maximum_steps=STEPS, catching=False)
    settings = RefereeSettings(
        autoplay=True, games=GAMES, seed=11, rules=rules, required=("simulator", "seeker", "planner", "predictor"), settle=0.0
    )
    cores = {
        "simulator": SimulatorCore(SimulatorSettings(camera=Camera(width=160, height=120))),
        "seeker": SeekerCore(),
        "planner": PlannerCore(),
        "predictor": make_core(PredictorSettings()),
        "referee": RefereeCore(settings),
    }
    with LogWriter(path, {}, sync=False) as writer:
        play(cores, GAMES, 1_000_000_000_000_000_000, writer)
    return path


def recorded(log: Path, key: str) -> list[Message]:
    return [without_clock(record.decode()) for record in read(log) if record.key == key]


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    path = Path(tempfile.mkdtemp(prefix="v", dir="/tmp"))
    yield path
    shutil.rmtree(path, ignore_errors=True)


class Listener:
    """Somebody on the bus, who remembers what was said."""

    def __init__(self, bus: ZenohBus) -> None:
        self.bus = bus
        self.heard: list[Sample] = []
        bus.subscribe(*WATCHED)

    def listen(self, seconds: float = 0.05) -> None:
        event = self.bus.receive(seconds)
        if isinstance(event, Sample):
            self.heard.append(event)

    def until(self, found: Callable[[], bool], what: str) -> None:
        wait(found, self.listen, lambda: f"{what}: it did not come; last {self.playback}")

    def until_it_stands(self) -> Playback:
        """Wait until the replay reports twice that it is paused at the same place."""
        self.until(lambda: [each.state for each in self.reports[-2:]] == ["paused"] * 2, "it stands")
        return self.reports[-1]

    def said(self, key: str, since: int = 0) -> list[Message]:
        return [sample.decode() for sample in self.heard[since:] if sample.key == key]

    @property
    def reports(self) -> list[Playback]:
        return self.said("playback")  # type: ignore[return-value]

    @property
    def playback(self) -> Playback | None:
        return self.reports[-1] if self.reports else None

    def health(self) -> Health:
        """What the planner says of itself next."""
        since = len(self.heard)
        self.until(lambda: bool(self.said("health/planner", since)), "the planner's health")
        return self.said("health/planner", since)[-1]  # type: ignore[return-value]

    def wish(self, **fields: object) -> int:
        """Say a wish, and wait until the replay shows that it was heard; returns from where on to look at what was said."""
        self.until(lambda: self.bus.has_reader("control"), "somebody hears wishes")
        since = len(self.heard)
        self.bus.publish("control", Control(stamp=time.time_ns(), **fields))  # type: ignore[arg-type]
        return since

    def seek(self, position: float) -> int:
        assert self.playback is not None
        jumps = self.playback.jumps
        since = self.wish(action="seek", position=position)
        self.until(lambda: self.playback is not None and self.playback.jumps > jumps, "a jump")
        return since


@pytest.fixture
def listener(folder: Path) -> Iterator[Listener]:
    with ZenohBus("command-line", folder) as bus:
        yield Listener(bus)


@pytest.fixture(scope="module")
def services(folder: Path) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """The predictor and the planner, alive."""
    started = {
        name: subprocess.Popen([sys.executable, "-m", f"services.{name}", "--folder", str(folder)], stderr=subprocess.DEVNULL)
        for name in ("predictor", "planner")
    }
    try:
        with ZenohBus("command-line", folder) as bus:
            silent = set(started)
            bus.subscribe(*(f"health/{name}" for name in silent))

            def listen() -> None:
                event = bus.receive(0.2)
                if isinstance(event, Sample):
                    silent.discard(event.publisher)

            wait(lambda: not silent, listen, lambda: f"silent: {silent}")
        yield started
    finally:
        for process in started.values():
            process.kill()
            process.wait()


@contextlib.contextmanager
def replay(log: Path, folder: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    command = [VANTAGE, "replay", str(log), "--folder", str(folder), "--no-start", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def finish(process: subprocess.Popen[str], code: int = 0) -> str:
    printed, complained = process.communicate(timeout=PATIENCE)
    assert process.returncode == code, printed + complained
    return printed + complained


def moments(log: Path, is_wanted: Callable[[Message], bool]) -> list[float]:
    """Seconds after the log's first message of every message that is wanted."""
    records = list(read(log))
    return [(record.log_time - records[0].log_time) / 1e9 for record in records if is_wanted(record.decode())]


def starts(log: Path) -> list[float]:
    """Seconds after the log's first message at which its games are set up."""
    return moments(log, lambda message: isinstance(message, Episode) and message.phase == "setup")


def tick_of(log: Path, game: int, step: int) -> float:
    """Seconds after the log's first message of a tick: what the planner needs for this step is then the newest, to the ns."""
    (moment,) = moments(log, lambda message: isinstance(message, Tick) and (message.episode, message.step) == (game, step))
    return moment


def plans(listener: Listener, since: int) -> list[tuple[int, int]]:
    """(episode, step) of what the planner planned."""
    return [(plan.episode, plan.step) for plan in listener.said("hider/plan", since)]


@pytest.mark.usefixtures("services")
def test_the_live_planner_says_what_was_recorded(log: Path, folder: Path, listener: Listener) -> None:
    """It plans while the replay stands at the first step of each game, so that it does not matter how long that takes."""
    with replay(log, folder, "--paused", "--once") as process:
        for number in range(1, GAMES + 1):
            listener.until_it_stands()
            listener.seek(tick_of(log, number, 0))
            listener.until(lambda n=number: len(plans(listener, 0)) == n, "a plan")
            listener.wish(action="resume", speed=QUICK)
            over = number * STEPS
            listener.until(lambda n=over: len(listener.said("hider/command")) >= n, "the commands of a game")
            if number < GAMES:
                listener.wish(action="pause")
        printed = finish(process)
    assert "planner: played by the live planner instead" in printed
    assert {sample.publisher for sample in listener.heard if sample.key == "hider/command"} == {"planner"}
    for key in ("hider/command", "hider/plan"):
        assert [without_clock(message) for message in listener.said(key)] == recorded(log, key), key


@pytest.mark.usefixtures("services")
def test_it_pauses_jumps_hurries_and_everybody_follows(log: Path, folder: Path, listener: Listener) -> None:
    games = starts(log)
    before = listener.health()
    with replay(log, folder, "--paused", "--game", "2") as process:
        listener.until(lambda: listener.playback is not None and listener.playback.state == "paused", "it waits")
        assert listener.playback is not None and listener.playback.position == pytest.approx(games[1], abs=1e-3)
        # Back and forth, into the middle of games: the planner joins there, while the replay stands.
        for game, step in ((2, 8), (1, 8), (2, 4), (1, 12)):
            since = listener.seek(tick_of(log, game, step))
            place = [(game, step)]
            listener.until(lambda s=since, p=place: plans(listener, s) == p, "the planner plans in the game sought")
        since = listener.wish(action="resume", speed=1.0)
        listener.until(lambda: bool(listener.said("tick", since)), "it plays")
        # A pause holds the stream, and the referee says so.
        since = listener.wish(action="pause")
        at = listener.until_it_stands()
        listener.until(lambda: any(word.paused for word in listener.said("episode", since)), "the referee's word")  # type: ignore[attr-defined]
        assert [report.position for report in listener.reports[-2:]] == [at.position] * 2
        place = at.episode, at.step
        assert all((tick.episode, tick.step) <= place for tick in listener.said("tick", since))
        assert all((pose.episode, pose.step) <= (at.episode, at.step + 1) for pose in listener.said("hider/pose", since))
        # At ten times the speed everything still comes, in order.
        since = listener.seek(0.0)
        listener.wish(action="resume", speed=QUICK)
        listener.until(lambda: listener.playback is not None and listener.playback.state == "ended", "the end")
        for key in ("tick", "hider/pose"):
            expected = [(message.episode, message.step) for message in recorded(log, key)]
            whole = len(expected)
            listener.until(lambda k=key, n=whole: len(listener.said(k, since)) >= n, f"the last {key}")
            assert [(message.episode, message.step) for message in listener.said(key, since)] == expected
        after = listener.health()
        assert after.failed == before.failed == 0 and not any(entry.lost or entry.malformed for entry in after.inputs)
        process.send_signal(signal.SIGTERM)
        finish(process)


def test_a_killed_replay_hangs_nobody_and_leaves_its_names_free(
    log: Path, folder: Path, services: dict[str, subprocess.Popen[bytes]], listener: Listener
) -> None:
    with replay(log, folder, "--speed", "1", "--from", "1") as process:
        listener.until(lambda: bool(listener.said("tick")), "it plays")
        process.kill()
    listener.until(lambda: "referee is not alive" in listener.health().reason, "the planner misses the referee")
    with replay(log, folder, "--speed", "100", "--once") as again:
        finish(again)
    services["planner"].send_signal(signal.SIGTERM)
    assert services["planner"].wait(timeout=PATIENCE) == 0


def test_keys_move_it_in_a_terminal(log: Path, folder: Path, listener: Listener) -> None:
    leader, follower = os.openpty()
    command = [VANTAGE, "replay", str(log), "--folder", str(folder), "--no-start", "--paused"]
    with subprocess.Popen(command, stdin=follower, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        os.close(follower)

        def key(sent: bytes, shown: Callable[[Playback], bool]) -> None:
            os.write(leader, sent)
            listener.until(lambda: listener.playback is not None and shown(listener.playback), f"{sent!r} shows")

        try:
            listener.until(lambda: listener.playback is not None and listener.playback.state == "paused", "it waits")
            key(b"\x1b[A", lambda playback: playback.speed == 2.0)
            key(b"n", lambda playback: playback.episode == 1)
            key(b"\x1b[C", lambda playback: playback.episode == 2 or playback.position >= 4.0)
            key(b" ", lambda playback: playback.state != "paused")
            os.write(leader, b"q")
            assert process.wait(PATIENCE) == 0, process.communicate()
            assert listener.playback is not None
        finally:
            process.kill()
            os.close(leader)


def test_a_live_referee_is_left_alone(log: Path, folder: Path) -> None:
    with ZenohBus("referee", folder), replay(log, folder) as process:
        said = finish(process, code=1)
    assert "vantage replay: a referee is alive" in said and "vantage down" in said and "Traceback" not in said


def test_a_deployment_is_started_around_it_and_stopped(log: Path) -> None:
    home = Path(tempfile.mkdtemp(prefix="v", dir="/tmp"))
    try:
        command = [VANTAGE, "replay", str(log), "--folder", str(home / "run"), "--once", "--speed", "20", "--arena", "lab"]
        outcome = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=PATIENCE, check=False)
        assert outcome.returncode == 0, outcome.stdout + outcome.stderr
        assert "starting predictor and console" in outcome.stdout and "watch in a browser: http://" in outcome.stdout
        # They are of the same arena, or nobody would be seen to be alive there.
        assert "predictor: played by the live predictor instead" in outcome.stdout
        assert not (home / "run" / "supervisor.sock").exists()
    finally:
        shutil.rmtree(home, ignore_errors=True)
