"""Collection: the same seed gives the same game, message for message; every policy plays; plans do not know of catches."""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import fields
from dataclasses import replace as replace_settings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from learning.collect import CollectSettings, log_path, main, play_block, seeds_from
from learning.collection import missing_blocks
from learning.hiders.recorded import read_trajectories
from learning.hiders.table import HIDERS
from learning.splits import split_of
from learning.stretches import stretches
from learning.verify import VerifySettings
from learning.verify import main as verify
from schemas import Plan, Pose
from services.simulator.core import SimulatorSettings
from vantage.errors import UserError
from vantage.log.episodes import episodes
from vantage.log.reader import read
from vantage.output import AlreadyExists
from vantage.world.camera import Camera


def collect(folder: Path, hider: str = "goal-walk", games: int = 3, **rules: object) -> Path:
    settings = CollectSettings(games=games, hider=hider, to=folder, steps=120, **rules)  # type: ignore[arg-type]
    path = folder / f"{hider}.mcap"
    play_block(settings, range(1, games + 1), path, (tuple(np.arange(n) % 5 for n in (30, 200)), (), ()))
    return path


def said(path: Path) -> dict[str, list[object]]:
    topics: dict[str, list[object]] = {}
    for record in read(path):
        message = record.decode()
        if isinstance(message, Plan):
            message = replace(message, elapsed=0.0)
        topics.setdefault(record.key, []).append(message)
    return topics


def test_the_same_seed_gives_the_same_game_message_for_message(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    first, second = said(collect(tmp_path / "a")), said(collect(tmp_path / "b"))
    assert first == second
    assert len(first["hider/command"]) > 3


@pytest.mark.parametrize("hider", sorted(HIDERS))
def test_every_policy_plays_whole_games(tmp_path: Path, hider: str) -> None:
    games = list(episodes(read(collect(tmp_path, hider))))
    assert len(games) == 3
    for game in games:
        assert game.complete
        assert game.episode.players.hider == hider
        assert set(game.commands["hider"]) == set(game.commands["seeker"]) == set(range(game.steps))


@pytest.mark.parametrize("hider", ["goal-walk", "random", "replay"])
def test_plans_reach_to_the_end_of_the_horizon_whatever_happens(tmp_path: Path, hider: str) -> None:
    for game in episodes(read(collect(tmp_path, hider))):
        assert min(game.plans) == 0
        for step, plan in game.plans.items():
            path = np.frombuffer(plan.path, np.float32).reshape(-1, 3)
            assert len(path) == 121 - step
            pose = game.poses["hider"][step]
            assert path[0] == pytest.approx((pose.x, pose.y, pose.heading % (2 * np.pi)), abs=1e-5)


def test_the_plan_in_force_is_what_happens_until_it_is_replaced(tmp_path: Path) -> None:
    checked = 0
    for game in episodes(read(collect(tmp_path, games=6))):
        starts = [*sorted(game.plans), game.steps + 1]
        for start, end in pairwise(starts):
            path = np.frombuffer(game.plans[start].path, np.float32).reshape(-1, 3)
            for step in range(start, end):
                pose = game.poses["hider"][step]
                refused = step == end - 1 and end <= game.steps
                if not refused:
                    assert path[step - start, :2] == pytest.approx((pose.x, pose.y), abs=1e-5)
                    checked += 1
    assert checked > 50


def test_an_evader_recorded_without_catches_can_be_replayed(tmp_path: Path) -> None:
    path = collect(tmp_path, "scripted", catching=False)
    trajectories = [primitives for split in read_trajectories(tmp_path).by_split for primitives in split]
    assert [len(primitives) for primitives in trajectories] == [120] * 3
    poses = [record.decode() for record in read(path, topics=("hider/pose",))]
    assert all(isinstance(pose, Pose) for pose in poses)
    assert any((primitives != 0).mean() > 0.3 for primitives in trajectories)


def test_collect_runs_in_parallel_and_resumes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = CollectSettings(games=4, hider="random", to=tmp_path, block=2, workers=2, steps=20)
    assert main(settings) == 0
    logs = sorted(tmp_path.glob("*.mcap"))
    assert [log_path(settings, 1), log_path(settings, 3)] == logs
    before = {path: list(read(path)) for path in logs}
    logs[1].unlink()
    assert main(settings) == 0
    assert "2 of them are there already" in capsys.readouterr().out
    assert {path: list(read(path)) for path in logs} == before


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def numbers(folder: Path) -> list[int]:
    return sorted(game.number for game in episodes(read(folder)))


def test_more_games_are_added_and_the_logs_that_are_there_stay_as_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = CollectSettings(games=3, hider="random", to=tmp_path, block=4, workers=1, steps=20)
    assert main(settings) == 0
    before = contents(tmp_path)
    assert main(replace_settings(settings, games=6)) == 0
    assert numbers(tmp_path) == list(range(1, 7))
    assert before.items() < contents(tmp_path).items()
    assert "3 of them are there already and are kept" in capsys.readouterr().out


def test_fewer_games_than_are_there_change_nothing_and_a_line_tells_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = CollectSettings(games=6, hider="random", to=tmp_path, block=10, workers=1, steps=5)
    assert main(settings) == 0
    before = contents(tmp_path)
    assert main(replace_settings(settings, games=2)) == 0
    assert "6 games of these settings are in" in capsys.readouterr().out
    assert contents(tmp_path) == before


OTHERS = {
    "steps": 6,
    "hider": "goal-walk",
    "seeker": "expert",
    "seed": 2,
    "layout": "lab",
    "period": 0.5,
    "catching": False,
    "views": True,
    "block": 3,
    "catch_distance": 0.2,
    "start_distance": (0.3, 0.45),
    "world": SimulatorSettings(Camera(noise=False)),
}


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> CollectSettings:
    settings = CollectSettings(games=2, hider="random", to=tmp_path_factory.mktemp("logs"), block=2, workers=1, steps=5)
    assert main(settings) == 0
    return settings


@pytest.mark.parametrize("name", OTHERS)
def test_a_folder_holds_games_of_one_kind_of_settings(collected: CollectSettings, name: str) -> None:
    before = contents(collected.to)
    option = "noise" if name == "world" else name.replace("_", "-")
    with pytest.raises(UserError, match=f"collected with other settings .--{option} .*--to"):
        main(replace_settings(collected, **{name: OTHERS[name]}))
    assert contents(collected.to) == before


def test_every_setting_that_decides_what_a_log_holds_is_in_its_identity() -> None:
    elsewhere = {"games", "to", "source", "driver", "workers"}
    assert {field.name for field in fields(CollectSettings)} == elsewhere | OTHERS.keys()


def test_a_log_that_was_cut_short_is_played_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = CollectSettings(games=4, hider="random", to=tmp_path, block=2, workers=1, steps=5)
    assert main(settings) == 0
    before = contents(tmp_path)
    path = log_path(settings, 3)
    path.write_bytes(path.read_bytes()[:-200])
    assert main(settings) == 0
    assert f"{path} was cut short" in capsys.readouterr().out
    assert contents(tmp_path) == before


def test_a_file_of_that_name_that_is_no_log_of_the_collection_is_not_overwritten(tmp_path: Path) -> None:
    settings = CollectSettings(games=2, hider="random", to=tmp_path, workers=1, steps=5)
    path = log_path(settings, 1)
    path.write_text("mine")
    with pytest.raises(AlreadyExists):
        main(settings)
    assert contents(tmp_path) == {path.name: b"mine"}


def test_logs_that_vanish_meanwhile_are_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = CollectSettings(games=4, hider="random", to=tmp_path, block=2, workers=1, steps=5)

    def play_and_lose(settings: CollectSettings, block: Sequence[int], path: Path, *rest: Any, **more: Any) -> int:
        if block[0] == 3:
            log_path(settings, 1).unlink()
        return play_block(settings, block, path, *rest, **more)

    monkeypatch.setattr("learning.collect.play_block", play_and_lose)
    with pytest.raises(UserError, match="lacks 2 games that were played"):
        main(settings)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_disk_that_fails_ends_it_and_keeps_no_log_that_lacks_a_message(tmp_path: Path, workers: int) -> None:
    """As on a full disk: the second log cannot grow beyond what the limit on files allows."""
    settings = CollectSettings(games=4, hider="random", to=tmp_path / "logs", block=2, workers=1, steps=60)
    assert main(settings) == 0
    whole = contents(settings.to)
    log_path(settings, 3).unlink()
    arguments = ["--games", "6", "--hider", "random", "--block", "2", "--steps", "60", "--to", str(settings.to)]
    limit = len(whole[log_path(settings, 3).name]) // 2
    outcome = run(["collect", *arguments, "--workers", str(workers)], limit)
    assert outcome.returncode == 1, outcome
    (line,) = outcome.stderr.splitlines()
    assert "File too large" in line and ".mcap" in line and "partial" not in line
    assert contents(settings.to) == {log_path(settings, 1).name: whole[log_path(settings, 1).name]}
    assert main(settings) == 0
    assert contents(settings.to) == whole


def run(arguments: list[str], largest_file: int) -> "subprocess.CompletedProcess[str]":
    """Run a command that may write files of a size only."""
    program = f"""
import resource, signal, sys
import learning.collect, learning.convert
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({largest_file}, {largest_file}))
sys.argv[1:] = {arguments!r}
from vantage.cli import main
main()"""
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=300)


def test_a_worker_that_is_killed_ends_the_command_with_its_cause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("learning.collect._play", killed)
    with pytest.raises(UserError, match="killed by SIGKILL"):
        main(CollectSettings(games=4, hider="random", to=tmp_path, block=2, workers=2, steps=5))
    assert contents(tmp_path) == {}


def killed(*_: object) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def test_unknown_hiders_and_missing_trajectories_are_clear_errors(tmp_path: Path) -> None:
    for settings, line in (
        (CollectSettings(hider="nobody", to=tmp_path), "goal-walk"),
        (CollectSettings(hider="replay", to=tmp_path), "--from FOLDER"),
        (CollectSettings(steps=0, to=tmp_path), "--steps"),
        (CollectSettings(period=-1.0, to=tmp_path), "--period"),
        (CollectSettings(start_distance=(0.4, 0.3), to=tmp_path), "--start-distance"),
        (CollectSettings(catch_distance=-1.0, to=tmp_path), "--catch-distance"),
        (CollectSettings(layout="nowhere.json", to=tmp_path), "nowhere.json"),
        (CollectSettings(block=0, to=tmp_path), "--block"),
        (CollectSettings(workers=-1, to=tmp_path), "--workers"),
    ):
        with pytest.raises(UserError, match=line):
            main(settings)


def test_an_episode_replays_only_what_was_recorded_in_its_own_split(tmp_path: Path) -> None:
    """Else a path that was learnt from would be judged in a test."""
    recorded = CollectSettings(games=40, hider="random", seed=20, to=tmp_path / "evader", workers=1, steps=12, catching=False)
    assert main(recorded) == 0
    by_split = read_trajectories(tmp_path / "evader").by_split
    assert [len(split) for split in by_split] == [sum(split_of(seed) == split for seed in range(20, 60)) for split in range(3)]
    assert all(by_split), "choose seeds that fall into every split"
    replayed = replace_settings(recorded, hider="replay", to=tmp_path / "replay", source=tmp_path / "evader")
    assert main(replayed) == 0
    for split, trajectories in enumerate(read_trajectories(tmp_path / "replay").by_split):
        own = {tuple(primitives) for primitives in by_split[split]}
        for primitives in trajectories:
            assert any(known[: len(primitives)] == tuple(primitives) for known in own)


def test_seeds_of_splits_in_which_nothing_was_recorded_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A person plays a handful of games, which seldom fall into every split."""
    few = CollectSettings(games=2, hider="random", seed=20, to=tmp_path / "few", workers=1, steps=12, catching=False)
    assert main(few) == 0
    assert {split_of(seed) for seed in (20, 21)} == {0}
    replayed = replace_settings(few, games=30, seed=20, hider="replay", source=tmp_path / "few", to=tmp_path / "replay")
    assert main(replayed) == 0
    assert "validation, test are left out" in capsys.readouterr().out
    expected = [seed for seed in range(20, 100) if split_of(seed) == 0][:30]
    assert expected[-1] > 20 + 30, "choose seeds that do not all fall into one split"
    played = [game.episode.seed for game in episodes(read(tmp_path / "replay"))]
    assert sorted(played) == expected
    assert len(list((tmp_path / "replay").glob("*.mcap"))) == 1


def leaving_out(tmp_path: Path) -> tuple[CollectSettings, list[int]]:
    """A collection of the training split alone, and its seeds."""
    few = CollectSettings(games=2, hider="random", seed=20, to=tmp_path / "few", workers=1, steps=6, catching=False)
    assert main(few) == 0
    settings = replace_settings(few, games=25, hider="replay", source=tmp_path / "few", to=tmp_path / "replay", block=10)
    return settings, [seed for seed in range(20, 100) if split_of(seed) == 0][:25]


def test_logs_have_their_size_whatever_seeds_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings, seeds = leaving_out(tmp_path)
    assert seeds[-1] - seeds[0] > 25
    assert main(settings) == 0
    assert f"25 games with seeds {seeds[0]} to {seeds[-1]}, in " in capsys.readouterr().out
    logs = sorted(settings.to.glob("*.mcap"))
    held = [[game.episode.seed for game in episodes(read(path))] for path in logs]
    assert held == [seeds[:10], seeds[10:20], seeds[20:]]
    for path in logs:
        for game in episodes(read(path)):
            assert game.complete and game.number == game.episode.seed
        assert verify(VerifySettings(path)) == 0, capsys.readouterr().out
    # Resumed: the same messages again, of what is missing alone.
    before = {path: list(read(path)) for path in logs}
    logs[1].unlink()
    capsys.readouterr()
    assert main(settings) == 0
    assert "15 of them are there already" in capsys.readouterr().out
    assert {path: list(read(path)) for path in logs} == before


def test_a_collection_whose_logs_are_cut_otherwise_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As one that was begun when a log could have no gaps in its seeds."""
    settings, seeds = leaving_out(tmp_path)
    found = read_trajectories(tmp_path / "few").by_split
    crumbs = [[seed - settings.seed + 1 for seed in crumb] for crumb in stretches(seeds)]
    assert len(crumbs) > 2
    for crumb in crumbs[:-1]:
        play_block(settings, crumb, log_path(settings, settings.seed + crumb[0] - 1), found)
    before = contents(settings.to)
    assert main(settings) == 0
    assert f"{len(seeds) - len(crumbs[-1])} of them are there already" in capsys.readouterr().out
    assert before.items() < contents(settings.to).items()
    assert numbers(settings.to) == seeds


@given(st.sets(st.integers(0, 60), min_size=1), st.sets(st.integers(0, 60)), st.integers(1, 9))
def test_the_missing_blocks_hold_every_missing_game_once(seeds: set[int], held: set[int], block: int) -> None:
    wanted = sorted(seeds)
    blocks = missing_blocks(wanted, held, block)
    assert [seed for some in blocks for seed in some] == [seed for seed in wanted if seed not in held]
    for some in blocks:
        first = wanted.index(some[0])
        assert some == wanted[first : first + len(some)], "what a log holds follows from its first seed and its games"
        assert first // block == (first + len(some) - 1) // block
    assert all(len(some) == block for some in missing_blocks(wanted, (), block)[:-1])


def test_seeds_of_a_collection_follow_each_other_within_the_splits() -> None:
    assert seeds_from(5, 4) == [5, 6, 7, 8]
    assert seeds_from(5, 4, frozenset({1})) == [seed for seed in range(5, 200) if split_of(seed) == 1][:4]
