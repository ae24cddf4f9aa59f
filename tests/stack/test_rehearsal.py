"""A real table's processes around a rehearsed one: games through cameras, tracker, driver and lines; plugs pulled, processes
killed. What came of it is judged from the log and from what health says.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from schemas import ROBOTS, ColorImage, DepthImage, Episode, Message, Motion, Pose, Track
from tests.stack.table import Table, follow, stop_games, troubles, wait, wish
from vantage.bus.zenoh_bus import ZenohBus
from vantage.cores import available_cores
from vantage.log import find_logs, open_log
from vantage.match import Match
from vantage.watch import HealthWatch

STEPS = 4
SEED = 2250
"""Its start is where the robots of the rehearsed table stand at first, and that of the next seed, the next game's, is near."""
SERVICES = ("recorder", "predictor", "referee", "rehearsal", "tracker", "robot", "seeker", "planner", "console")
BLAMED = {
    "tracker": ("tracker is not alive", "tracker: "),
    "robot": ("robot or onboard is not alive", "robot: ", "the driver was restarted", "/motion from robot is"),
    "rehearsal": ("tracker: ", "robot: "),
}
"""Killed service: what the reason of an aborted game may name. A real table's referee does not know of the rehearsal: what it
stands for, cameras and lines, is missed by tracker and driver."""
CAMERAS = ("overhead camera", "hider camera", "seeker camera")


@pytest.fixture(scope="module")
def rehearsal() -> Iterator[Table]:
    with Table("rehearsal", "--with", f"rehearsal=--layout-seed {SEED}") as running:
        yield running


def read_back(table: Table) -> list[Message]:
    """All messages of all logs so far, in the order in which they were recorded."""
    messages: list[Message] = []
    for parts in find_logs(table.logs):
        with open_log(*parts) as log:
            messages.extend(record.decode() for record in log.records())
    return messages


def listen_until(watch: HealthWatch, said: Callable[[str], bool], service: str) -> str:
    """Listen to health until a service says something; returns it."""

    def trouble() -> str:
        return next(verdict.trouble for verdict in watch.verdicts() if verdict.process.name == service)

    wait(lambda: said(trouble()), lambda: watch.listen(0.1), lambda: str(troubles(watch.verdicts())))
    return trouble()


def test_up_ends_with_every_service_healthy(rehearsal: Table) -> None:
    assert rehearsal.started.returncode == 0, rehearsal.started.stderr
    assert set(rehearsal.services()) == set(SERVICES)


def test_a_game_is_played_through_cameras_and_wheels(rehearsal: Table) -> None:
    outcome = rehearsal.command("play", "--seed", str(SEED), "--steps", str(STEPS), "--deployment", "rehearsal")
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    assert "the hider survived" in outcome.stdout or "was caught" in outcome.stdout


def test_its_log_keeps_the_contract(rehearsal: Table) -> None:
    """From the log alone: every step's pictures and poses are there, captured after the motions that led to them."""
    said: list[Message] = []

    def read_again() -> None:
        said[:] = read_back(rehearsal)
        time.sleep(0.2)

    def of_game(*kinds: type[Message]) -> list[Any]:
        return [message for message in said if isinstance(message, kinds) and message.episode == number]

    def ended() -> list[Episode]:
        return [message for message in said if isinstance(message, Episode) and message.phase == "ended"]

    wait(lambda: bool(ended()), read_again, lambda: "the end of the game is not on the log")
    number, steps = ended()[0].episode, range(ended()[0].step + 1)
    # Topics are recovered each for itself: on a busy machine some reach the log after the end of the game.
    whole = ((Pose, 2), (Motion, 2), (DepthImage, 2), (ColorImage, 2))
    wait(
        lambda: all(len(of_game(kind)) >= count * len(steps) for kind, count in whole),
        read_again,
        lambda: f"not all of {[kind.__name__ for kind, _ in whole]} are on the log",
    )
    poses, motions, pictures = of_game(Pose), of_game(Motion), of_game(DepthImage, ColorImage)
    assert sorted(pose.step for pose in poses) == [step for step in steps for _ in ROBOTS]
    assert sorted(motion.step for motion in motions) == [step for step in steps for _ in ROBOTS]
    assert sorted(picture.step for picture in pictures) == [step for step in steps for _ in range(4)]
    assert all(motion.result in ("completed", "refused", "stuck", "timed-out") for motion in motions)
    for step in steps:
        rested = max(motion.stamp for motion in motions if motion.step == step)
        assert all(message.stamp > rested for message in (*poses, *pictures) if message.step == step)
    assert of_game(Track)
    for pose in poses:
        assert 0.0 < pose.x < 1.2 and 0.0 < pose.y < 1.2 and abs(pose.heading) <= math.pi


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def test_beside_busy_loops_games_slow_down_and_nobody_is_called_silent_who_was_not(rehearsal: Table) -> None:
    before = max(message.episode for message in read_back(rehearsal) if isinstance(message, Episode))
    with busy_loops(2 * available_cores()):
        outcome = rehearsal.command("play", "--seed", str(SEED), "--steps", str(STEPS), "--deployment", "rehearsal")
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    said = [message for message in read_back(rehearsal) if isinstance(message, Episode | Motion) and message.episode > before]
    assert not [message.reason for message in said if isinstance(message, Episode) and message.phase == "aborted"]
    motions = [message for message in said if isinstance(message, Motion)]
    assert motions and {motion.result for motion in motions} <= {"completed", "refused", "stuck", "timed-out"}


def test_status_of_a_rehearsal(rehearsal: Table) -> None:
    document = json.loads(rehearsal.command("status", "rehearsal", "--json").stdout)
    assert {row["service"] for row in document["services"]} == set(SERVICES)
    assert all(row["failed"] == 0 and row["malformed"] == 0 for row in document["services"])


def test_a_camera_unplugged_is_named_and_plugged_in_again_all_is_well(rehearsal: Table) -> None:
    with HealthWatch(rehearsal.deployment) as watch:
        rehearsal.wait_until_healthy(watch)
        for camera in CAMERAS[:2]:
            unplug(rehearsal, camera)  # and plug the one before it in again
            named = f"{camera}: no frame for"
            listen_until(watch, lambda trouble, c=camera, n=named: n in trouble and named_in(trouble) == [c], "tracker")  # type: ignore[misc]
        unplug(rehearsal)
        rehearsal.wait_until_healthy(watch)


def named_in(trouble: str) -> list[str]:
    return [camera for camera in CAMERAS if camera in trouble]


def test_a_line_unplugged_aborts_the_game_with_the_reason_and_the_next_one_is_played(rehearsal: Table) -> None:
    with HealthWatch(rehearsal.deployment) as watch, ZenohBus("command-line", rehearsal.folder) as bus:
        rehearsal.wait_until_healthy(watch)
        match = Match(bus, wish(seed=SEED, games=1, steps=60, period=0.25))
        follow(match, lambda: match.step >= 2, "the game gets to step 2")
        unplug(rehearsal, "seeker line")
        follow(match, lambda: bool(match.games), "the game is given up")
        episode = match.games[0].episode
        assert episode.phase == "aborted"
        assert "seeker" in episode.reason, episode.reason
        unplug(rehearsal)
        rehearsal.wait_until_healthy(watch)
    with ZenohBus("command-line", rehearsal.folder) as bus:
        again = Match(bus, wish(seed=SEED, games=1, steps=2, period=0.25))
        follow(again, lambda: bool(again.games), "a game after that")
        assert again.games[0].episode.phase == "ended", again.games[0].episode.reason


@pytest.mark.parametrize("service", ["tracker", "robot", "rehearsal"])
def test_a_process_killed_in_mid_game_comes_again_and_games_go_on(rehearsal: Table, service: str) -> None:
    with HealthWatch(rehearsal.deployment) as watch, ZenohBus("command-line", rehearsal.folder) as bus:
        rehearsal.wait_until_healthy(watch)
        others = {name: rehearsal.pid_of(name) for name in SERVICES if name != service}
        match = Match(bus, wish(seed=SEED, games=4, steps=40, period=0.25))
        follow(match, lambda: match.step >= 2, "the game gets to step 2")
        assert match.current is not None
        number, step, pid = match.current.episode, match.step, rehearsal.pid_of(service)
        os.kill(pid, signal.SIGKILL)
        rehearsal.wait_until_healthy(watch, replaced=pid)

        def goes_on() -> bool:
            current = match.current
            return current is not None and match.step > (step + 1 if current.episode == number else 0)

        follow(match, goes_on, "the game goes on, or another one runs")
        ended = {game.episode.episode: game.episode for game in match.games}
        # Either it went on, or whoever watches is told whom it waited for in vain.
        assert number in ended or (match.current is not None and match.current.episode == number)
        for episode in ended.values():
            if episode.phase == "aborted":
                assert any(name in episode.reason for name in BLAMED[service]), episode.reason
        assert {name: rehearsal.pid_of(name) for name in others} == others
    stop_games(rehearsal.folder)


def unplug(table: Table, *plugs: str) -> None:
    """Pull these plugs of the rehearsed table, and put all others in."""
    faults: Path = table.folder / "unplugged"
    faults.with_suffix(".part").write_text("\n".join(plugs))
    faults.with_suffix(".part").replace(faults)
