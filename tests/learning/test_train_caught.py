"""Networks that say "caught": their labels against the games, that they learn and go on, and that nothing leaks the outcome."""

import copy
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from learning import train_caught
from learning.caught_batch import plan_labels, render
from learning.collect import CollectSettings, play_block
from learning.convert import convert
from learning.dataset import Dataset, Samples
from learning.group import Group
from learning.recipe import CAUGHT_PRESETS, CaughtModel, CaughtRecipe
from learning.train_caught import TrainCaughtSettings, Trainer, make_network
from learning.training_identity import OtherTraining
from vantage.networks.hazard import Hazard, HazardSettings
from vantage.networks.weights import load_any, read_card

T = 60
ALONE = Group(0, 1, torch.device("cpu"))
SMALL = replace(CAUGHT_PRESETS["compact"], encoder=(8,) * 8, batch=8)
MODELS: tuple[CaughtModel, ...] = ("hazard", "hazard-attention", "coordinate-path", "coordinate-end")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("training")
    settings = CollectSettings(hider="goal-walk", seed=52, steps=T)  # seeds of all three splits
    play_block(settings, range(1, 31), folder / "log.mcap")
    convert([folder / "log.mcap"], folder / "dataset", workers=1, quiet=True)
    return Dataset(folder / "dataset")


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def test_labels_are_the_outcomes_as_far_as_plan_and_game_reach(dataset: Dataset) -> None:
    samples = dataset.draw("train", 400, np.random.default_rng(0))
    caught, known = plan_labels(dataset, samples, checkpoints=8, spacing=10)
    assert caught.any() and not caught.all()
    for b in range(len(samples)):
        row, start = dataset.episodes[samples.episode[b]], int(samples.start[b])
        plan = dataset.plans[dataset.steps["plan"][row["first_step"] + start]]
        for k in range(8):
            step = start + 10 * k + 9
            assert caught[b, k] == (0 <= row["caught_step"] <= step)
            assert known[b, k] == (10 * k + 9 < T and step <= T and step < plan["start"] + plan["positions"])
    assert known.any(axis=1).mean() > 0.9 and (known.sum(axis=1) == 6).any() and (known.sum(axis=1) < 6).any()


@pytest.mark.parametrize("model", MODELS)
def test_nothing_that_is_shown_tells_of_the_outcome(dataset: Dataset, model: CaughtModel) -> None:
    """Had the game ended otherwise after t0, the network would have been shown the same."""
    network = make_network(model, SMALL)
    samples = dataset.draw("train", 64, np.random.default_rng(1), from_start=1.0)
    other = copy.copy(dataset)
    other.episodes = dataset.episodes.copy()
    escaped = other.episodes["caught_step"] < 0
    other.episodes["caught_step"] = np.where(escaped, 1, -1)
    other.episodes["steps"] = np.where(escaped, 2, T + 1)
    shown, shown_otherwise = render(network, dataset, samples), render(network, other, samples)
    np.testing.assert_array_equal(shown.images, shown_otherwise.images)
    np.testing.assert_array_equal(shown.vectors, shown_otherwise.vectors)
    np.testing.assert_array_equal(shown.known, shown_otherwise.known)


def test_the_hazard_network_is_shown_the_whole_plan_whatever_the_horizon(dataset: Dataset) -> None:
    network = Hazard(HazardSettings(encoder=(8,) * 8))
    zero = np.zeros(1, np.int64)
    short = Samples(zero, zero, zero + 3, zero + 5, dataset.caught(zero, zero + 3))
    longest = dataset.longest_horizon(short.episode, short.start)
    assert longest[0] == T - 1
    whole = dataset.render(replace(short, horizon=longest))
    np.testing.assert_array_equal(render(network, dataset, short).images, whole.inputs)


@pytest.mark.parametrize("model", MODELS)
def test_a_view_is_turned_with_its_plan(dataset: Dataset, model: CaughtModel) -> None:
    network = make_network(model, SMALL)
    samples = dataset.draw("train", 8, np.random.default_rng(2), symmetries=1)
    upright, turned = (render(network, dataset, replace(samples, symmetry=np.full(8, k))) for k in (0, 1))
    np.testing.assert_array_equal(turned.images, np.rot90(upright.images, axes=(1, 2)))
    if model != "hazard":
        np.testing.assert_allclose(turned.vectors[:, 0], -upright.vectors[:, 1], atol=1e-6)
        np.testing.assert_allclose(turned.vectors[:, 1], upright.vectors[:, 0], atol=1e-6)
        whole = np.minimum(dataset.longest_horizon(samples.episode, samples.start), 199)
        reach = whole if model == "hazard-attention" else samples.horizon
        np.testing.assert_allclose(turned.vectors[:, -1], reach / 400, atol=1e-6)


@pytest.mark.parametrize("model", ["hazard", "hazard-attention", "coordinate-path"])
def test_it_learns_one_batch_by_heart(dataset: Dataset, model: CaughtModel) -> None:
    trainer = Trainer(model, replace(SMALL, dropout=0.0), ALONE, compiled=False, seed=0)
    batch = render(trainer.network, dataset, dataset.draw("train", 8, np.random.default_rng(0)))
    losses = [float(trainer.learn(batch, 3.0)) for _ in range(25)]
    assert losses[-1] < 0.5 * losses[0]


def test_a_restored_trainer_goes_on_as_if_never_stopped(dataset: Dataset) -> None:
    recipe = replace(SMALL, dropout=0.0)
    straight, resumed = (Trainer("hazard", recipe, ALONE, compiled=False, seed=seed) for seed in (0, 5))
    drawn = [dataset.draw("train", 8, np.random.default_rng(number)) for number in range(4)]
    batches = [render(straight.network, dataset, samples) for samples in drawn]
    for batch in batches[:2]:
        straight.learn(batch, 1.0)
    resumed.restore(copy.deepcopy(straight.state()))
    for batch in batches[2:]:
        assert float(straight.learn(batch, 0.5)) == float(resumed.learn(batch, 0.5))


@pytest.mark.parametrize("model", MODELS)
def test_from_training_to_weights(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, model: CaughtModel
) -> None:
    monkeypatch.setitem(CAUGHT_PRESETS, "compact", SMALL)
    settings = TrainCaughtSettings(
        model=model,
        data=dataset.folder,
        to=tmp_path / "weights" / f"{model}.safetensors",
        preset="compact",
        samples=32,
        workspace=tmp_path / "run",
        report_every=16,
        validation=64,
        threads=1,
    )
    assert train_caught.main(settings) == 0
    assert settings.to is not None
    network, card = load_any(settings.to)
    assert network.architecture == make_network(model, SMALL).architecture
    assert network.settings == make_network(model, SMALL).settings
    assert (card.data["hash"], card.preset, card.training["batch"]) == (dataset.hash, "compact", 8)
    assert 0 <= card.metrics["accuracy"] <= 1 and card.metrics["loss"] > 0
    json.dumps(card.metrics)
    capsys.readouterr()
    assert train_caught.main(replace(settings, samples=48)) == 0
    assert "going on after 32 samples" in capsys.readouterr().out
    assert read_card(settings.to).training["samples"] <= 48
    assert list((tmp_path / "run").glob("events.*"))
    with pytest.raises(OtherTraining, match=r"recipe rate .* there, 0.002 here"):
        train_caught.main(replace(settings, rate=2e-3))


def test_the_preset_paper_has_the_encoder_and_the_recipe_of_vpt_tob() -> None:
    from learning.recipe import PRESETS as VPT_TOB

    mine, theirs = CAUGHT_PRESETS["paper"], VPT_TOB["paper"]
    assert mine.encoder == theirs.network.encoder
    for name in ("samples", "batch", "rate", "schedule", "drop", "from_start", "symmetries"):
        assert getattr(mine, name) == getattr(theirs, name)
    assert isinstance(mine, CaughtRecipe)
