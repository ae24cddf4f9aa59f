"""A gathered set: exact sizes, the stated mixture, and the same bits however often it was interrupted."""

import json
import multiprocessing
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from learning import collect, gather
from learning.collect import LARGEST_SEED, CollectSettings
from learning.convert import ConvertSettings, convert
from learning.convert import main as convert_main
from learning.dataset import Dataset
from learning.dataset_tables import TooFewGames
from learning.gather import MIXTURE, GatherSettings, Refusal, games_needed, plan, sizes_by_hider
from learning.splits import SPLITS, split_of
from vantage.errors import UserError
from vantage.log import find_logs
from vantage.output import AlreadyExists

SMALL = GatherSettings(train=11, validation=3, test=2, steps=12, block=25, workers=1)
HIDERS = ("goal-walk", "random", "replay")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gather") / "whole"
    assert gather.main(replace(SMALL, to=folder)) == 0
    return folder


def manifest_of(folder: Path) -> dict[str, Any]:
    manifest = json.loads((folder / "manifest.json").read_text())
    return {name: value for name, value in manifest.items() if not name.startswith("com")}  # commit, commits, command


def test_the_splits_have_exactly_the_wanted_sizes_and_the_stated_mixture(whole: Path) -> None:
    data = Dataset(whole / "dataset")
    assert data.manifest["episodes"] == {"train": 11, "validation": 3, "test": 2}
    wanted = sizes_by_hider((11, 3, 2))
    for hider in MIXTURE:
        mine = data.episodes[data.episodes["hider"] == hider.encode()]
        assert tuple(int((mine["split"] == split).sum()) for split in range(3)) == wanted[hider]
        first = SMALL.seed + MIXTURE[hider].first_seed
        for split, size in enumerate(wanted[hider]):  # the lowest seeds of its split, none left out in between
            seeds = sorted(mine["seed"][mine["split"] == split].tolist())
            candidates = (seed for seed in range(first, first + 1000) if split_of(seed) == split)
            assert seeds == [seed for _, seed in zip(range(size), candidates, strict=False)]
    played = sum(made["games"] for name, made in manifest_of(whole)["seeds"].items() if name != "evader")
    assert data.manifest["left_out"] == {"beyond the wanted size": played - 16}


def test_cutting_to_size_changes_nothing_in_the_games_that_stay(whole: Path, tmp_path: Path) -> None:
    convert([whole / "logs"], tmp_path / "all", workers=1, quiet=True)
    some, every = Dataset(whole / "dataset"), Dataset(tmp_path / "all")
    assert len(every.episodes) > len(some.episodes)
    rows = {int(seed): row for row, seed in enumerate(every.episodes["seed"])}
    same = np.array([rows[int(seed)] for seed in some.episodes["seed"]])
    for name in ("id", "hider", "steps", "caught_step", "split"):
        np.testing.assert_array_equal(some.episodes[name], every.episodes[name][same])
    for row, twin in enumerate(same):
        cut = np.arange(some.episodes["steps"][row])
        mine, theirs = some.episodes["first_step"][row] + cut, every.episodes["first_step"][twin] + cut
        for robot in ("hider", "seeker"):
            np.testing.assert_array_equal(some.steps[robot][mine], every.steps[robot][theirs])
        for step, other in zip(mine, theirs, strict=True):
            assert [some.image(step, robot) for robot in (0, 1)] == [every.image(other, robot) for robot in (0, 1)]
            here, there = some.plans[some.steps["plan"][step]], every.plans[every.steps["plan"][other]]
            assert (here["start"], here["positions"]) == (there["start"], there["positions"])
            np.testing.assert_array_equal(_positions(some, here), _positions(every, there))


def _positions(data: Dataset, plan: np.void) -> np.ndarray:
    return data.positions[plan["first_position"] : plan["first_position"] + plan["positions"]]


class Interrupted(Exception):
    pass


@pytest.mark.parametrize("at", ["evader", "replay", "conversion"])
def test_interrupted_and_gone_on_gives_the_same_bits(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    """Broken off with some logs of a stage written; then gone on with, once on two workers."""
    settings = replace(SMALL, to=tmp_path / "set", block=25, workers=1)
    real = gather.collect

    def breaks_off(collection: CollectSettings) -> int:
        if at in (collection.to.name, collection.hider):
            real(replace(collection, games=collection.block))
            raise Interrupted
        return real(collection)

    def fails(*_: object, **__: object) -> None:
        raise Interrupted

    with monkeypatch.context() as broken:
        if at == "conversion":
            broken.setattr("learning.convert.shift_rows", fails)
        else:
            broken.setattr(gather, "collect", breaks_off)
        with pytest.raises(Interrupted):
            gather.main(settings)
    assert not (settings.to / "dataset").exists()
    assert gather.main(replace(settings, workers=2 if at == "replay" else 1)) == 0
    assert manifest_of(settings.to) == manifest_of(whole)
    for name in ("episodes", "steps", "plans", "positions", "offsets"):
        assert (settings.to / "dataset" / f"{name}.npy").read_bytes() == (whole / "dataset" / f"{name}.npy").read_bytes()
    assert (settings.to / "dataset" / "images.lz4").read_bytes() == (whole / "dataset" / "images.lz4").read_bytes()


def test_the_hashes_do_not_depend_on_the_commit(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log's file names the commit; what was said in it, and the training set, must not."""
    monkeypatch.setattr(collect, "source_commit", lambda: "another commit")
    made = plan(replace(SMALL, to=tmp_path), sizes_by_hider((11, 3, 2)), dict.fromkeys(MIXTURE, (0, 0, 0)))["random"]
    name = collect.log_path(made, made.seed).name
    collect.play_block(made, range(1, made.block + 1), tmp_path / name)
    there = whole / "logs" / "random" / name
    assert (tmp_path / name).read_bytes() != there.read_bytes()
    assert gather.hash_of(tmp_path / name) == gather.hash_of(there) == manifest_of(whole)["logs"][f"logs/random/{name}"]
    first, second = (convert([path], tmp_path / f"d{n}", 1, True) for n, path in enumerate((tmp_path / name, there)))
    assert first["hash"] == second["hash"]


def test_a_finished_set_says_so_and_another_configuration_is_refused(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("*")}
    assert gather.main(replace(SMALL, to=whole, workers=2)) == 0
    assert "finished" in capsys.readouterr().out
    for other in (
        replace(SMALL, seeker="expert"),
        replace(SMALL, layout="lab"),
        replace(SMALL, steps=13),
        replace(SMALL, train=12),
        replace(SMALL, seed=2),
    ):
        with pytest.raises(Refusal, match="another set") as refused:
            gather.main(replace(other, to=whole))
        (changed,) = (name for name in vars(other) if getattr(other, name) != getattr(SMALL, name))
        held, wanted = getattr(SMALL, changed), getattr(other, changed)
        assert f"(--{changed} {held}, not {wanted})" in str(refused.value)
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("*")} == before


def test_no_seed_serves_two_policies_and_all_kinds_share_their_seeds() -> None:
    wanted = sizes_by_hider((4500, 500, 500))
    spare = dict.fromkeys(MIXTURE, (0, 0, 0))
    ranges = {}
    for kind in (GatherSettings(), GatherSettings(seeker="expert"), GatherSettings(layout="lab"), GatherSettings(steps=350)):
        made = plan(kind, wanted, spare)
        ranges[kind] = {name: range(one.seed, one.seed + one.games) for name, one in made.items()}
        assert [one.hider for one in made.values()] == ["scripted", *HIDERS]
        assert all(one.rules.catching == (name != "evader") for name, one in made.items())
        assert made["replay"].source == made["evader"].to
    assert len({str(value) for value in ranges.values()}) == 1
    seeds = Counter(seed for one in next(iter(ranges.values())).values() for seed in one)
    assert max(seeds.values()) == 1


@pytest.mark.parametrize("sizes", [(4500, 500, 500), (1, 0, 0), (7, 3, 3), (0, 0, 1), (13, 1, 2)])
def test_shares_are_rounded_without_loss(sizes: tuple[int, int, int]) -> None:
    by_hider = sizes_by_hider(sizes)
    assert sum(part.share for part in MIXTURE.values()) == pytest.approx(1.0)
    for split, size in enumerate(sizes):
        assert sum(counts[split] for counts in by_hider.values()) == size
        assert all(abs(counts[split] - size * MIXTURE[hider].share) < 1 for hider, counts in by_hider.items())


def test_as_many_games_as_the_seeds_say_and_not_one_more() -> None:
    for wanted in ((5, 2, 1), (0, 3, 0), (40, 5, 5)):
        games = games_needed(7, wanted)
        for count, enough in ((games, True), (games - 1, False)):
            splits = Counter(split_of(seed) for seed in range(7, 7 + count))
            assert all(splits[split] >= size for split, size in enumerate(wanted)) == enough
    with pytest.raises(Refusal, match="gather less"):
        games_needed(1, (1_000_000, 0, 0))


def test_games_that_cannot_serve_are_made_up_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def lacks_once(*_: object, **options: object) -> dict[str, object]:
        asked.append(options["wanted"])
        if len(asked) == 1:
            raise TooFewGames({"random": (2, 0, 1)})
        raise Interrupted

    collected: list[CollectSettings] = []
    monkeypatch.setattr(gather, "convert", lacks_once)

    def collects(collection: CollectSettings) -> int:
        collected.append(collection)
        return 0

    monkeypatch.setattr(gather, "collect", collects)
    with pytest.raises(Interrupted):
        gather.main(replace(SMALL, to=tmp_path, block=1))
    wanted = sizes_by_hider((11, 3, 2))
    assert asked == [wanted, wanted]
    first, second = collected[:4], collected[4:]
    train, validation, test = wanted["random"]
    for before, after in zip(first, second, strict=True):
        more = games_needed(before.seed, (train + 2, validation, test + 1)) if before.hider == "random" else before.games
        assert after == replace(before, games=more)


def test_too_few_games_are_told_and_leave_the_old_set(whole: Path, tmp_path: Path) -> None:
    convert([whole / "logs"], tmp_path / "set", workers=1, quiet=True)
    before = (tmp_path / "set" / "manifest.json").read_bytes()
    with pytest.raises(TooFewGames, match="gather more") as refused:
        convert([whole / "logs"], tmp_path / "set", workers=1, quiet=True, wanted={"random": (10_000, 0, 0)}, force=True)
    assert 9_900 < refused.value.lacking["random"][0] < 10_000
    assert (tmp_path / "set" / "manifest.json").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


def test_a_training_set_of_other_making_is_not_replaced(tmp_path: Path) -> None:
    kept = tmp_path / "dataset" / "manifest.json"
    kept.parent.mkdir()
    kept.write_text("{}")
    with pytest.raises(AlreadyExists, match="dataset exists already: it is not of this set: choose another --to"):
        gather.main(replace(SMALL, to=tmp_path))
    assert kept.read_text() == "{}" and [path.name for path in tmp_path.iterdir()] == ["dataset"]


def test_an_empty_split_is_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    seed = next(seed for seed in range(1, 99) if split_of(seed) == split_of(seed + 1) == 0)
    made = CollectSettings(hider="random", seed=seed, steps=5)
    collect.play_block(made, range(1, 3), tmp_path / "log.mcap")
    assert convert_main(ConvertSettings((tmp_path / "log.mcap",), tmp_path / "set", workers=1)) == 0
    assert f"no {SPLITS[1]} and no {SPLITS[2]} games" in capsys.readouterr().err


def test_seeds_that_the_virtual_clock_cannot_hold_are_refused(tmp_path: Path) -> None:
    last = CollectSettings(games=1, hider="random", seed=LARGEST_SEED, to=tmp_path, workers=1, steps=3)
    assert collect.main(last) == 0
    for impossible in (replace(last, games=2), replace(last, seed=10**9), replace(last, seed=-1), replace(last, games=0)):
        with pytest.raises(UserError, match=f"0 .. {LARGEST_SEED:,}"):
            collect.main(impossible)


def test_a_replay_of_other_recordings_is_not_kept(tmp_path: Path) -> None:
    evader = CollectSettings(games=40, hider="random", seed=20, to=tmp_path / "evader", workers=1, steps=4, catching=False)
    replay = replace(evader, games=2, hider="replay", to=tmp_path / "replay", source=evader.to, catching=True)
    assert collect.main(evader) == collect.main(replay) == collect.main(replay) == 0
    assert collect.main(replace(evader, seed=120, to=evader.to / "more")) == 0
    with pytest.raises(UserError, match="other trajectories"):
        collect.main(replay)


def test_unfinished_logs_of_the_dead_are_removed_and_those_of_the_living_kept(tmp_path: Path) -> None:
    process = multiprocessing.get_context("spawn").Process(target=print)
    process.start()
    process.join()
    mine, dead = (tmp_path / f".a.partial-{pid}.mcap" for pid in (multiprocessing.current_process().pid, process.pid))
    mine.touch()
    dead.touch()
    settings = CollectSettings(games=1, hider="random", to=tmp_path, workers=1, steps=3)
    assert collect.main(settings) == 0
    assert mine.exists() and not dead.exists()
    assert len(find_logs(tmp_path)) == 1
