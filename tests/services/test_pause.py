"""A pause in mid-game disturbs nobody: all cores of a simulated game, in one process, say the same as without it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
from msgspec.structs import replace

from learning.in_process import play
from learning.process_replay import without_clock
from schemas import TOPICS, Control, Episode, Message, Players, Rules, Tick
from services.planner.core import PlannerCore
from services.predictor.core import PredictorCore
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore
from services.simulator.core import SimulatorCore, SimulatorSettings
from vantage.log import LogWriter
from vantage.log.episodes import episodes
from vantage.log.reader import read
from vantage.networks.inference import Inference
from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.vpt_tob import VptTob, VptTobSettings
from vantage.service import SECOND, Arrived, Core, Declaration, Publish, Received, Runtime, Send, Woken
from vantage.world.camera import Camera

STEPS = 25
PLAYERS = ("simulator", "seeker", "planner", "predictor")


class Pauser:
    """Holds the clock at some steps, for an hour each."""

    declaration = Declaration("command-line", inputs=("tick",), outputs=("control",))

    def __init__(self, at: Sequence[int]) -> None:
        self._at = set(at)
        self._wake: int | None = None

    def wake_at(self) -> int | None:
        return self._wake

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Arrived) and isinstance(received.message, Tick) and received.message.step in self._at:
            self._at.remove(received.message.step)
            self._wake = now + 3600 * SECOND
            return (Publish("control", Control(stamp=now, action="pause")),)
        if isinstance(received, Woken) and self._wake is not None and now >= self._wake:
            self._wake = None
            return (Publish("control", Control(stamp=now, action="resume")),)
        return ()


@pytest.fixture(scope="module")
def networks() -> Inference:
    torch.manual_seed(0)
    return Inference(VptTob(VptTobSettings(width=0.25)), Vpn(VpnSettings(width=4)), batch=64, threads=1)


def logged(path: Path, period: float, at: Sequence[int], networks: Inference, monkeypatch: pytest.MonkeyPatch) -> list[Runtime]:
    """Play a game that is paused at some steps into a log; return the services as they were afterwards."""
    rules = Rules(step_period=period, maximum_steps=STEPS)
    settings = RefereeSettings(autoplay=True, games=1, seed=11, rules=rules, required=PLAYERS, settle=0.0)
    cores: dict[str, Core] = {
        "simulator": SimulatorCore(SimulatorSettings(camera=Camera(width=160, height=120))),
        "seeker": SeekerCore(),
        "planner": PlannerCore(),
        "predictor": PredictorCore(networks),
        "referee": RefereeCore(settings),
        "command-line": Pauser(at),
    }
    runtimes: list[Runtime] = []

    def kept(core: Core, *rest: object, **options: object) -> Runtime:
        runtimes.append(Runtime(core, *rest, **options))  # type: ignore[arg-type]
        return runtimes[-1]

    with monkeypatch.context() as patch, LogWriter(path, {}, sync=False) as writer:
        patch.setattr("learning.in_process.Runtime", kept)
        play(cores, 1, 1_000_000_000_000_000_000, writer)
    return runtimes


def said(path: Path) -> dict[str, list[Message]]:
    """Return every topic's messages but those that tell of a pause."""
    topics: dict[str, list[Message]] = {key: [] for key in TOPICS}
    running = 0
    for record in read(path):
        message = record.decode()
        if isinstance(message, Episode) and message.phase == "running":
            running += 1
            if running > 1:
                continue
        if not isinstance(message, Control):
            topics[record.key].append(without_clock(message))
    return topics


@pytest.mark.parametrize("period", [0.0, 0.25])
def test_a_paused_game_is_the_same_game(
    period: float, networks: Inference, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logged(tmp_path / "without.mcap", period, (), networks, monkeypatch)
    runtimes = logged(tmp_path / "with.mcap", period, (0, 3, 4, STEPS - 1), networks, monkeypatch)
    without, paused = said(tmp_path / "without.mcap"), said(tmp_path / "with.mcap")
    for key in TOPICS:
        assert without[key] == paused[key], key
    assert len(without["hider/command"]) > 6 and without["hider/plan"]
    for runtime in runtimes:
        report = runtime.health_report("ok")
        assert (report.unexpected, report.failed) == (0, 0), report.reason
    (game,) = episodes(read(tmp_path / "with.mcap"))
    assert game.complete and not game.episode.paused
    stamps = {tick.step: tick.stamp for tick in game.ticks}
    held = [step for step in range(1, game.steps) if stamps[step] - stamps[step - 1] >= 3600 * SECOND]
    assert held == [1, 4, 5]


def test_a_game_of_another_hider_leaves_nothing_in_the_planner(tmp_path: Path) -> None:
    """Its own next game is played as if there had been no other."""
    from learning.collect import CollectSettings, play_block

    play_block(CollectSettings(hider="random", steps=100, catching=False), range(1, 2), tmp_path / "log")
    planner = PlannerCore()
    for record in read(tmp_path / "log"):
        message = record.decode()
        if isinstance(message, Episode):
            message = replace(message, players=Players(hider="human"))
        if record.key in planner.declaration.inputs:
            assert planner.step(Arrived(record.key, message), record.log_time) == ()
            assert len(planner._join._waiting) <= 1 and planner.wake_at() is None
