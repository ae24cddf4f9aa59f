"""Collection: the same seed gives the same game, message for message; every policy plays; plans do not know of catches."""

from dataclasses import replace as replace_settings
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from learning.collect import CollectSettings, blocks_of, crumbs_of, episodes_of, log_path, main, play_block
from learning.hiders.recorded import read_trajectories
from learning.hiders.table import HIDERS
from learning.splits import split_of
from learning.stretches import stretches
from learning.verify import VerifySettings
from learning.verify import main as verify
from schemas import Plan, Pose, Rules
from vantage.log.episodes import episodes
from vantage.log.reader import read


def collect(folder: Path, hider: str = "goal-walk", episodes: int = 3, **rules: object) -> Path:
    settings = CollectSettings(episodes=episodes, hider=hider, to=folder, rules=Rules(maximum_steps=120, **rules))  # type: ignore[arg-type]
    path = folder / f"{hider}.mcap"
    play_block(settings, range(1, episodes + 1), path, (tuple(np.arange(n) % 5 for n in (30, 200)), (), ()))
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
    for game in episodes(read(collect(tmp_path, episodes=6))):
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
    settings = CollectSettings(episodes=4, hider="random", to=tmp_path, block=2, workers=2, rules=Rules(maximum_steps=20))
    assert main(settings) == 0
    logs = sorted(tmp_path.glob("*.mcap"))
    assert [log_path(settings, range(1, 3)), log_path(settings, range(3, 5))] == logs
    before = {path: list(read(path)) for path in logs}
    logs[1].unlink()
    assert main(settings) == 0
    assert "1 of 2 logs are there already" in capsys.readouterr().out
    assert {path: list(read(path)) for path in logs} == before


def test_more_games_are_added_and_other_settings_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = CollectSettings(episodes=3, hider="random", to=tmp_path, block=2, workers=1, rules=Rules(maximum_steps=20))
    assert main(settings) == 0
    assert main(replace_settings(settings, episodes=4)) == 0
    assert sum(len(list(episodes(read(path)))) for path in tmp_path.glob("*.mcap")) == 4
    assert main(replace_settings(settings, rules=Rules(maximum_steps=30))) == 2
    assert "other settings" in capsys.readouterr().err


def test_unknown_hiders_and_missing_trajectories_are_clear_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(CollectSettings(hider="nobody", to=tmp_path)) == 2
    assert "goal-walk" in capsys.readouterr().err
    assert main(CollectSettings(hider="replay", to=tmp_path)) == 2
    assert "--from FOLDER" in capsys.readouterr().err


def test_an_episode_replays_only_what_was_recorded_in_its_own_split(tmp_path: Path) -> None:
    """Else a path that was learnt from would be judged in a test."""
    rules = Rules(maximum_steps=12, catching=False)
    recorded = CollectSettings(episodes=40, hider="random", seed=20, to=tmp_path / "evader", workers=1, rules=rules)
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
    rules = Rules(maximum_steps=12, catching=False)
    few = CollectSettings(episodes=2, hider="random", seed=20, to=tmp_path / "few", workers=1, rules=rules)
    assert main(few) == 0
    assert {split_of(seed) for seed in (20, 21)} == {0}
    replayed = replace_settings(few, episodes=30, seed=20, hider="replay", source=tmp_path / "few", to=tmp_path / "replay")
    assert main(replayed) == 0
    assert "validation, test are left out" in capsys.readouterr().out
    expected = [seed for seed in range(20, 100) if split_of(seed) == 0][:30]
    assert expected[-1] > 20 + 30, "choose seeds that do not all fall into one split"
    played = [game.episode.seed for game in episodes(read(tmp_path / "replay"))]
    assert sorted(played) == expected
    assert len(list((tmp_path / "replay").glob("*.mcap"))) == 1


def leaving_out(tmp_path: Path) -> tuple[CollectSettings, list[int]]:
    """A collection of the training split alone, and its seeds."""
    rules = Rules(maximum_steps=6, catching=False)
    few = CollectSettings(episodes=2, hider="random", seed=20, to=tmp_path / "few", workers=1, rules=rules)
    assert main(few) == 0
    settings = replace_settings(few, episodes=25, hider="replay", source=tmp_path / "few", to=tmp_path / "replay", block=10)
    return settings, [seed for seed in range(20, 100) if split_of(seed) == 0][:25]


def test_logs_have_their_size_whatever_seeds_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings, seeds = leaving_out(tmp_path)
    assert seeds[-1] - seeds[0] > 25
    assert main(settings) == 0
    assert f"25 games with seeds {seeds[0]} to {seeds[-1]}, in 3 logs" in capsys.readouterr().out
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
    assert "2 of 3 logs are there already" in capsys.readouterr().out
    assert {path: list(read(path)) for path in logs} == before


def test_a_collection_begun_without_gaps_in_its_logs_goes_on_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings, seeds = leaving_out(tmp_path)
    found = read_trajectories(tmp_path / "few").by_split
    settings.to.mkdir()
    crumbs = crumbs_of(settings, frozenset({0}))
    assert len(crumbs) > 3
    for crumb in crumbs[:-1]:
        play_block(settings, crumb, log_path(settings, crumb), found)
    assert main(settings) == 0
    assert f"{len(crumbs) - 1} of {len(crumbs)} logs are there already" in capsys.readouterr().out
    assert [game.episode.seed for game in episodes(read(settings.to))] == seeds


@given(st.sets(st.integers(0, 60), min_size=1), st.integers(1, 9))
def test_blocks_and_crumbs_hold_every_episode_once(seeds: set[int], block: int) -> None:
    numbers = sorted(seeds)
    assert [number for stretch in stretches(numbers) for number in stretch] == numbers
    settings = CollectSettings(episodes=len(seeds), block=block)
    for playable in (frozenset({0}), frozenset({0, 1, 2})):
        expected = episodes_of(settings, playable)
        blocks, crumbs = blocks_of(settings, playable), crumbs_of(settings, playable)
        for made in (blocks, crumbs):
            assert [episode for each in made for episode in each] == expected
        assert all(len(each) == block for each in blocks[:-1])
    assert [list(each) for each in crumbs] == blocks, "nothing is left out: as ever"
