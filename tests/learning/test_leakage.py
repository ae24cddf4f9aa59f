"""Nothing that is learnt from, or shown to a network, knows what is to be predicted. Each test fails if somebody breaks it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from learning import evaluate, gather, recipe, train_caught, train_vpn, train_vpt_tob
from learning.accuracy.examples import draw_examples
from learning.collect import CollectSettings, play_block
from learning.convert import convert
from learning.dataset import Dataset, Samples
from learning.gather import MIXTURE, GatherSettings
from learning.hiders.recorded import read_trajectories
from learning.recipe import PRESETS, VPN_PRESETS
from learning.roll_outs.start import start_of
from learning.splits import SPLITS, split_of
from learning.train_vpn import Views, repeated, streamed
from learning.value_maps.truth import seeds_of_test_split
from tests.learning.made_weights import NARROW, save_untrained
from vantage.log import read
from vantage.log.episodes import EpisodeLog, episodes
from vantage.perception.action_maps import draw_action_maps

T = 60
GATHERED = GatherSettings(train=60, validation=15, test=15, steps=T, workers=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("leakage") / "set"
    assert gather.main(replace(GATHERED, to=folder)) == 0
    return folder


@pytest.fixture(scope="module")
def data(folder: Path) -> Dataset:
    return Dataset(folder / "dataset")


@pytest.fixture(scope="module")
def games(folder: Path) -> dict[int, EpisodeLog]:
    return {game.episode.seed: game for path in sorted((folder / "logs").iterdir()) for game in episodes(read(path))}


def samples_of(data: Dataset, episode: NDArray[np.int64], start: int, horizon: NDArray[np.int64]) -> Samples:
    starts = np.full(len(episode), start, np.int64)
    return Samples(episode, starts, horizon, np.zeros(len(episode), np.int64), data.caught(episode, starts + horizon))


def of_split(data: Dataset, split: str) -> set[int]:
    """Rows of the episodes of a split, told by their seeds alone."""
    return {row for row, seed in enumerate(data.episodes["seed"].tolist()) if SPLITS[split_of(seed)] == split}


def caught_early(data: Dataset) -> NDArray[np.int64]:
    """Episodes with a catch well before the end."""
    rows = np.flatnonzero((data.episodes["caught_step"] >= 3) & (data.episodes["caught_step"] < T - 15))
    assert len(rows) > 20
    return rows


def test_f_and_t_are_of_the_plan_as_it_was_logged_up_to_the_horizon(data: Dataset, games: dict[int, EpisodeLog]) -> None:
    rows = caught_early(data)
    for start in (0, 1, 2):
        horizon = data.longest_horizon(rows, np.full(len(rows), start))
        assert (horizon == min(T - 1, T - start)).all()  # no game is too short for a horizon, however early the catch
        batch = data.render(samples_of(data, rows, start, horizon))
        for number, row in enumerate(rows):
            plans = games[int(data.episodes["seed"][row])].plans
            made = max(step for step in plans if step <= start)
            path = np.frombuffer(plans[made].path, np.float32).reshape(-1, 3)
            assert len(path) == T + 1 - made
            frequency, time = np.empty((2, 128, 128, 2), np.uint8)
            draw_action_maps(path, start - made, start - made + int(horizon[number]), frequency, time)
            np.testing.assert_array_equal(batch.inputs[number, ..., 3:5], frequency)
            np.testing.assert_array_equal(batch.inputs[number, ..., 5:7], time)


def test_t_tells_the_horizon_of_every_sample_and_so_nothing_of_a_catch(data: Dataset) -> None:
    """The darkest shade of T is that of its last step: of the horizon, in games that were over by then and in all others."""
    samples = data.draw("train", 1500, np.random.default_rng(1))
    inputs = data.render(samples).inputs
    shades = np.where(inputs[..., 6] > 0, inputs[..., 5], 255).reshape(len(samples), -1).min(axis=1)
    np.testing.assert_array_equal(shades, np.round(255 * (1 - samples.horizon / 400)).astype(np.uint8))
    assert 200 < samples.caught.sum() < 1300


def test_horizons_do_not_depend_on_the_outcome(data: Dataset) -> None:
    """A horizon is drawn alike in games that end early, late and never."""
    samples = data.draw("train", 60_000, np.random.default_rng(2), from_start=1.0)
    caught_step = data.episodes["caught_step"][samples.episode]
    expected, deviation = (T - 1) / 2, np.sqrt((T**2 - 1) / 12)
    for mine in (caught_step < 0, (caught_step >= 0) & (caught_step < 15), caught_step >= 15):
        assert mine.sum() > 1000
        horizons = samples.horizon[mine]
        assert abs(horizons.mean() - expected) < 5 * deviation / np.sqrt(mine.sum())
        counts, edges = np.histogram(horizons, bins=6, range=(0, T))
        assert len(edges) == 7 and abs(counts / mine.sum() - 1 / 6).max() < 5 * np.sqrt(5 / 36 / mine.sum())


@pytest.mark.parametrize("target", ["seeker", "hider"])
def test_after_a_catch_the_target_is_the_view_at_the_catch(
    data: Dataset, games: dict[int, EpisodeLog], target: str, tmp_path: Path
) -> None:
    rows = caught_early(data)
    caught_step = data.episodes["caught_step"][rows].astype(np.int64)
    at, last = (
        data.render(samples_of(data, rows, 0, horizon), target)  # type: ignore[arg-type]
        for horizon in (caught_step, np.full(len(rows), T - 1))
    )
    np.testing.assert_array_equal(at.targets, last.targets)
    assert at.caught.all() and last.caught.all()
    before = data.render(samples_of(data, rows, 0, caught_step - 1), target)  # type: ignore[arg-type]
    assert not before.caught.any()
    assert (before.targets != at.targets).any(axis=(1, 2, 3)).mean() > 0.5
    assert (data.episodes["steps"][rows] == caught_step + 1).all()  # what was recorded past the catch is not even stored


def test_a_seed_decides_the_split_for_good() -> None:
    """Released weights were trained on these seeds: they must never become test."""
    assert "".join(str(split_of(seed)) for seed in range(1, 61)) == "000000000000000000000000000000000020002000000000000220000011"


def test_no_episode_start_or_view_is_in_two_splits(data: Dataset) -> None:
    split = data.episodes["split"]
    assert split.tolist() == [split_of(int(seed)) for seed in data.episodes["seed"]]
    first = data.episodes["first_step"]
    starts = [data.steps[robot][first] for robot in ("hider", "seeker")]
    by_kind: dict[str, list[Any]] = {
        "seed": [int(seed) for seed in data.episodes["seed"]],
        "start": [(hider.tobytes(), seeker.tobytes()) for hider, seeker in zip(*starts, strict=True)],
        "view": [data.image(int(step), 1) for step in first],
    }
    for kind, keys in by_kind.items():
        by_split = [{key for key, own in zip(keys, split, strict=True) if own == number} for number in range(3)]
        assert all(by_split) and sum(map(len, by_split)) == len(set().union(*by_split)), kind


def test_what_is_drawn_is_of_the_split_that_was_asked_for(data: Dataset) -> None:
    for split in SPLITS:
        assert set(data.draw(split, 3000, np.random.default_rng(0)).episode.tolist()) == of_split(data, split)


def test_no_recording_is_replayed_in_two_splits(folder: Path, games: dict[int, EpisodeLog]) -> None:
    recorded = read_trajectories(folder / "evader").by_split
    assert all(recorded)
    numbers = {"stay": 0, "forward": 1, "backward": 2, "left": 3, "right": 4}
    told_apart = 0
    for seed, game in games.items():
        if game.episode.players.hider != "replay":
            continue
        commands = game.commands["hider"]
        played = [numbers[commands[step].primitive] for step in range(len(commands))]
        fits = [any(known[: len(played)].tolist() == played for known in own) for own in recorded]
        assert fits[split_of(seed)]
        told_apart += sum(fits) == 1
    assert told_apart > 25


@pytest.mark.parametrize("layout", ["random", "lab"])
def test_starts_of_an_evaluation_were_never_trained_on(data: Dataset, layout: str) -> None:
    tested = seeds_of_test_split(1, 60)
    assert {split_of(seed) for seed in tested} == {SPLITS.index("test")}
    firsts = [1 + part.first_seed for part in MIXTURE.values()]
    trained = [seed for first in firsts for seed in range(first, first + 200) if split_of(seed) != SPLITS.index("test")]
    starts = [
        {(start.boxes.tobytes(), start.poses.tobytes()) for start in (start_of(layout, seed) for seed in seeds)}
        for seeds in (tested, trained)
    ]
    assert len(starts[0]) == len(tested) and not starts[0] & starts[1]
    row = data.of_split("train")[0]  # a start by its seed is that of the recorded game
    recorded = data.steps[data.episodes["first_step"][row]]
    if layout == "random":
        poses = start_of(layout, int(data.episodes["seed"][row])).poses
        assert [recorded[robot][axis] for robot in ("hider", "seeker") for axis in "xy"] == pytest.approx(poses[:, :2].ravel())


class Watched:
    """Notes which episodes are drawn, and which are shown to anybody."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.drawn: list[str] = []
        self.shown: set[int] = set()
        for name in ("render", "questions"):
            monkeypatch.setattr(Dataset, name, self._noting(getattr(Dataset, name)))
        draw = Dataset.draw

        def drawing(data: Dataset, split: str, *rest: object, **options: object) -> Samples:
            self.drawn.append(split)
            return draw(data, split, *rest, **options)  # type: ignore[arg-type]

        monkeypatch.setattr(Dataset, "draw", drawing)

    def _noting(self, method: Callable[..., object]) -> Callable[..., object]:
        def noting(data: Dataset, samples: Samples, *rest: object, **options: object) -> object:
            self.shown |= set(samples.episode.tolist())
            return method(data, samples, *rest, **options)

        return noting


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    return Watched(monkeypatch)


@pytest.fixture(scope="module")
def weights(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights")
    save_untrained(folder, data.hash)
    return folder


def test_an_evaluation_shows_test_episodes_only(data: Dataset, weights: Path, watched: Watched, tmp_path: Path) -> None:
    settings = evaluate.EvaluateSettings(
        data=data.folder, weights=weights, samples=(40,), horizons=(T,), to=tmp_path / "results", ablations=True, threads=1
    )
    assert evaluate.main(settings) == 0
    assert watched.shown and watched.shown <= of_split(data, "test")
    for start in ("uniform", "first"):
        assert set(draw_examples(data, "test", 40, start, T, 1).episode.tolist()) <= of_split(data, "test")


@pytest.mark.parametrize("stream", [True, False])
def test_vpn_learns_from_predictions_for_training_episodes_only(data: Dataset, watched: Watched, stream: bool) -> None:
    recipe = replace(VPN_PRESETS["compact"], stream=stream, images=24, epochs=2, batch=8, pool=64)
    batches = (streamed if stream else repeated)(Views(data, None, torch.device("cpu")), recipe, 1, 0)
    for _ in range(3):
        next(batches)
    batches.close()  # type: ignore[attr-defined]
    assert watched.drawn and set(watched.drawn) == {"train"}
    assert watched.shown and watched.shown <= of_split(data, "train")


@pytest.mark.parametrize("what", ["vpt-tob", "vpn", "vpn, fixed set", "hazard"])
def test_no_training_looks_at_a_test_episode(
    data: Dataset, weights: Path, watched: Watched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    narrow = replace(PRESETS["compact"], network=replace(PRESETS["compact"].network, encoder=NARROW))
    monkeypatch.setitem(PRESETS, "compact", narrow)
    monkeypatch.setitem(recipe.CAUGHT_PRESETS, "compact", replace(recipe.CAUGHT_PRESETS["compact"], encoder=NARROW))
    for preset in ("compact", "paper"):
        monkeypatch.setitem(VPN_PRESETS, preset, replace(VPN_PRESETS[preset], held=32, batch=32))
    to, workspace = tmp_path / "made.safetensors", tmp_path / "run"
    if what == "vpt-tob":
        code = train_vpt_tob.main(
            train_vpt_tob.TrainVptTobSettings(
                data=data.folder, to=to, workspace=workspace, preset="compact", samples=8, batch=4, threads=1, compile="off"
            )
        )
    elif what == "hazard":
        code = train_caught.main(
            train_caught.TrainCaughtSettings(
                data=data.folder,
                to=to,
                workspace=workspace,
                preset="compact",
                samples=8,
                batch=4,
                threads=1,
                compile="off",
            )
        )
    else:
        views = weights / "vpt-tob.safetensors"
        code = train_vpn.main(
            train_vpn.TrainVpnSettings(
                data=data.folder,
                views=views,
                to=to,
                workspace=workspace,
                preset="compact" if what == "vpn" else "paper",
                images=256,
                epochs=2,
                threads=1,
            )
        )
    assert code == 0
    assert {"train", "validation"} == set(watched.drawn)
    assert not watched.shown & of_split(data, "test")


def test_convert_takes_the_split_from_the_seed_alone(folder: Path, tmp_path: Path) -> None:
    """One log or many, cut to size or not: an episode's split is the same."""
    log = sorted((folder / "logs").iterdir())[1]
    convert([log], tmp_path / "one", workers=1, quiet=True)
    alone = Dataset(tmp_path / "one")
    assert alone.episodes["split"].tolist() == [split_of(int(seed)) for seed in alone.episodes["seed"]]
    assert len(set(alone.episodes["split"].tolist())) == 3


def test_plans_do_not_know_of_the_catch(tmp_path: Path) -> None:
    """The same game with catches and without: the same plans, up to the catch."""
    for hider in ("goal-walk", "random"):
        pair = []
        for catching in (True, False):
            settings = CollectSettings(hider=hider, seed=5, steps=T, catching=catching)
            path = tmp_path / f"{hider}-{catching}.mcap"
            play_block(settings, range(1, 9), path)
            pair.append({game.episode.seed: game for game in episodes(read(path))})
        compared = 0
        for seed, game in pair[0].items():
            caught = game.episode.caught_step
            for step, plan in game.plans.items():
                assert plan.path == pair[1][seed].plans[step].path
                compared += caught is not None
        assert compared >= 3
