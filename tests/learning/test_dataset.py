"""From real logs to samples: what a sample shows, what its label is, and that the same logs give the same training set."""

import json
from pathlib import Path

import numpy as np
import pytest

from learning.collect import CollectSettings, play_block
from learning.convert import convert
from learning.dataset import SPLITS, Batch, Dataset, Samples, UnusableDataset, prefetch
from learning.splits import split_of
from vantage.log import read
from vantage.log.episodes import EpisodeLog, episodes
from vantage.networks.inputs import CHANNELS, render_inputs
from vantage.perception.palette import to_rgb
from vantage.perception.state_image import perceive

T = 60
GAMES = 12


def play(folder: Path, hider: str, first: int, count: int, **rules: object) -> None:
    settings = CollectSettings(hider=hider, seed=first, steps=T, **rules)  # type: ignore[arg-type]
    play_block(settings, range(1, count + 1), folder / f"{hider}_{first}.mcap")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    play(folder, "goal-walk", 1, GAMES - 4)
    play(folder, "random", 101, 4)
    play(folder, "scripted", 201, 2, catching=False)
    return folder


@pytest.fixture(scope="module")
def dataset(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("set") / "dataset"
    convert([logs], folder, workers=1, quiet=True)
    return Dataset(folder)


@pytest.fixture(scope="module")
def games(logs: Path) -> dict[int, EpisodeLog]:
    return {game.number: game for game in episodes(read(logs))}


def sample(dataset: Dataset, episode: int, start: int, horizon: int) -> Batch:
    one, at, ahead = (np.array([value]) for value in (episode, start, horizon))
    return dataset.render(Samples(one, at, ahead, np.zeros(1, np.int64), dataset.caught(one, at + ahead)))


def test_every_finished_game_with_a_plan_is_there_with_its_outcome(dataset: Dataset, games: dict[int, EpisodeLog]) -> None:
    assert len(dataset.episodes) == GAMES
    assert list(dataset.manifest["left_out"].values()) == [2]
    for row in dataset.episodes:
        game = games[int(row["id"])]
        caught = game.episode.caught_step
        assert row["caught_step"] == (-1 if caught is None else caught)
        assert row["steps"] == (T if caught is None else caught) + 1
        for step in range(row["steps"]):
            pose, stored = game.poses["seeker"][step], dataset.steps["seeker"][row["first_step"] + step]
            assert stored.item() == pytest.approx((pose.x, pose.y, pose.heading), abs=1e-6)


def test_a_sample_shows_what_the_robots_perceived_and_the_plan_in_force(dataset: Dataset, games: dict[int, EpisodeLog]) -> None:
    generator = np.random.default_rng(0)
    for number, row in enumerate(dataset.episodes):
        game = games[int(row["id"])]
        start = int(generator.integers(row["steps"] - 1))
        longest = int(dataset.longest_horizon(np.array([number]), np.array([start]))[0])
        horizon = int(generator.integers(longest + 1))
        batch = sample(dataset, number, start, horizon)
        end = min(start + horizon, int(row["steps"]) - 1)
        views = []
        for robot, step in (("hider", start), ("seeker", end)):
            view = perceive(game.depths[robot][step], game.colors[robot][step], game.poses[robot][step], robot)  # type: ignore[index,arg-type]
            views.append(view.image)
        np.testing.assert_array_equal(batch.targets[0], to_rgb(views[1]))
        made = max(step for step in game.plans if step <= start)
        path = np.frombuffer(game.plans[made].path, np.float32).reshape(-1, 3)[start - made :]
        expected, zero = np.empty((1, 128, 128, CHANNELS), np.uint8), np.zeros(1, np.int64)
        render_inputs(views[0][None], zero, path, zero, np.array([horizon]), zero, expected)
        np.testing.assert_array_equal(batch.inputs, expected)


def test_after_a_catch_the_game_is_frozen_and_the_plan_goes_on(dataset: Dataset) -> None:
    number = int(np.argmax((dataset.episodes["caught_step"] >= 2) & (dataset.episodes["caught_step"] < T - 20)))
    caught = int(dataset.episodes["caught_step"][number])
    assert caught >= 2
    before, at, after = (sample(dataset, number, 0, horizon) for horizon in (caught - 1, caught, caught + 15))
    assert [bool(batch.caught[0]) for batch in (before, at, after)] == [False, True, True]
    np.testing.assert_array_equal(after.targets, at.targets)
    assert (after.inputs[..., 3:] != at.inputs[..., 3:]).any()  # F and T tell of the horizon, not of the catch
    longest = dataset.longest_horizon(np.array([number]), np.array([0]))
    assert longest[0] == T - 1


def test_drawn_samples_are_within_reach_and_horizons_are_uniform(dataset: Dataset) -> None:
    samples = dataset.draw("train", 20_000, np.random.default_rng(1), from_start=0.5)
    assert set(samples.episode.tolist()) == set(dataset.of_split("train").tolist())
    assert (samples.horizon <= dataset.longest_horizon(samples.episode, samples.start)).all()
    assert 0.5 <= (samples.start == 0).mean() < 0.56
    counts = np.bincount(samples.horizon[samples.start == 0], minlength=T)
    assert len(counts) == T
    assert counts.min() > 0.6 * counts.mean()
    assert set(samples.symmetry.tolist()) == set(range(8))
    limited = dataset.draw("train", 500, np.random.default_rng(1), horizon_limit=10)
    assert limited.horizon.max() == 9


def test_the_split_goes_by_seed_and_is_about_eight_one_one(dataset: Dataset) -> None:
    assert dataset.episodes["split"].tolist() == [split_of(seed) for seed in dataset.episodes["seed"].tolist()]
    shares = np.bincount([split_of(seed) for seed in range(20_000)], minlength=3) / 20_000
    assert shares == pytest.approx([0.8, 0.1, 0.1], abs=0.01)
    rows = [set(dataset.of_split(split).tolist()) for split in SPLITS]
    assert sum(map(len, rows)) == len(set().union(*rows)) == GAMES


def test_the_same_logs_give_the_same_training_set_with_any_number_of_workers(
    logs: Path, dataset: Dataset, tmp_path: Path
) -> None:
    manifest = convert([logs], tmp_path / "again", workers=2, quiet=True)
    assert manifest["hash"] == dataset.hash
    assert {**manifest, "commit": ""} == {**dataset.manifest, "commit": ""}


@pytest.mark.parametrize(("spoil", "says"), [("missing", "vantage convert"), ("version", "version 99"), ("cut", "broken")])
def test_what_is_no_training_set_is_refused_in_one_line(logs: Path, tmp_path: Path, spoil: str, says: str) -> None:
    folder = tmp_path / "dataset"
    if spoil != "missing":
        convert([logs / "random_101.mcap"], folder, workers=1, quiet=True)
    if spoil == "version":
        manifest = json.loads((folder / "manifest.json").read_text())
        (folder / "manifest.json").write_text(json.dumps({**manifest, "schema_version": 99}))
    if spoil == "cut":
        (folder / "steps.npy").write_bytes(b"")
    with pytest.raises(UnusableDataset, match=says):
        Dataset(folder)


def test_a_folder_that_is_no_training_set_is_never_replaced(logs: Path) -> None:
    before = sorted(path.name for path in logs.iterdir())
    with pytest.raises(UnusableDataset, match="not replaced"):
        convert([logs], logs, workers=1, quiet=True)
    assert sorted(path.name for path in logs.iterdir()) == before


def test_prefetch_yields_everything_in_order_and_passes_errors_on() -> None:
    assert list(prefetch(lambda: iter(range(50)), ahead=3)) == list(range(50))

    def failing() -> object:
        yield 1
        raise UnusableDataset("gone")

    stream = prefetch(failing)  # type: ignore[arg-type]
    assert next(stream) == 1
    with pytest.raises(UnusableDataset, match="gone"):
        next(stream)
