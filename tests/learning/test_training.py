"""Training end to end on real logs, small: it learns, goes on where it stopped, and its weights answer and are evaluated."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from learning import evaluate, train_vpn, train_vpt_tob
from learning.collect import CollectSettings, play_block
from learning.convert import convert
from learning.dataset import Dataset
from learning.group import Group
from learning.recipe import PRESETS, Recipe, rate_factor
from learning.train_vpt_tob import Trainer, TrainVptTobSettings
from schemas import Rules
from vantage.networks.inference import Inference
from vantage.networks.vpt_tob import VptTob, VptTobSettings
from vantage.networks.weights import load, read_card

ALONE = Group(0, 1, torch.device("cpu"))
SMALL = replace(PRESETS["compact"], network=VptTobSettings(width=0.25, whole_image=True, caught_head=True), batch=8)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("training")
    settings = CollectSettings(hider="goal-walk", seed=52, rules=Rules(maximum_steps=40))  # seeds of all three splits
    play_block(settings, range(1, 31), folder / "log.mcap")
    convert([folder / "log.mcap"], folder / "dataset", workers=1, quiet=True)
    return Dataset(folder / "dataset")


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def test_the_recipe_paper_is_the_papers() -> None:
    recipe = PRESETS["paper"]
    assert (recipe.rate, recipe.batch, recipe.disc_weight, recipe.head_weight, recipe.judge_weight) == (1e-3, 256, 1, 0, 0)
    assert recipe.network == VptTobSettings()
    factors = [rate_factor(recipe, progress) for progress in (0.0, 0.24, 0.25, 0.64, 0.65, 1.0)]
    assert factors == pytest.approx([1, 1, 0.9, 0.9, 0.81, 0.81])
    assert train_vpn.PRESETS["paper"] == train_vpn.Recipe(images=2000, epochs=100, batch=256, rate=5e-4, symmetries=4)
    assert train_vpn.rate_factor(train_vpn.PRESETS["paper"], 0.5) == pytest.approx(0.81)


@pytest.mark.parametrize("recipe", [SMALL, Recipe(network=VptTobSettings(width=0.25), batch=8)])
def test_it_learns_one_batch_by_heart(dataset: Dataset, recipe: Recipe) -> None:
    trainer = Trainer(recipe, ALONE, compiled=False, seed=0)
    batch = dataset.render(dataset.draw("train", 8, np.random.default_rng(0)))
    losses = [float(trainer.learn(batch, 3.0)) for _ in range(25)]
    assert losses[-1] < 0.6 * losses[0]


def test_a_restored_trainer_goes_on_as_if_never_stopped(dataset: Dataset) -> None:
    batches = [dataset.render(dataset.draw("train", 8, np.random.default_rng(number))) for number in range(4)]
    straight = Trainer(SMALL, ALONE, compiled=False, seed=0)
    for batch in batches[:2]:
        straight.learn(batch, 1.0)
    state = straight.state()
    resumed = Trainer(SMALL, ALONE, compiled=False, seed=5)
    resumed.restore({name: None if part is None else _copied(part) for name, part in state.items()})
    for batch in batches[2:]:
        assert float(straight.learn(batch, 0.5)) == float(resumed.learn(batch, 0.5))


def _copied(state: dict[str, object]) -> dict[str, object]:
    import copy

    return copy.deepcopy(state)


def test_from_training_to_answers_and_results(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    weights = tmp_path / "weights"
    monkeypatch.setitem(PRESETS, "compact", SMALL)
    settings = TrainVptTobSettings(
        data=dataset.folder,
        to=weights / "vpt-tob.safetensors",
        preset="compact",
        samples=96,
        workspace=tmp_path / "run",
        report_every=48,
        threads=1,
    )
    assert train_vpt_tob.main(settings) == 0
    network, card = load(settings.to, VptTob)
    assert network.settings == SMALL.network
    assert card.data["hash"] == dataset.hash
    assert card.training["samples"] <= 96
    assert any("Not the paper's network" in note for note in card.notes)
    assert (tmp_path / "run" / "latest.png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    assert "50.0 %" in printed and "100.0 %" in printed and "min left" in printed

    assert train_vpt_tob.main(replace(settings, samples=144)) == 0  # goes on from the checkpoint
    assert "going on after 96 samples" in capsys.readouterr().out
    assert train_vpt_tob.main(replace(settings, disc_weight=2.0)) == 1  # not the same training
    assert "another recipe" in capsys.readouterr().out

    again = replace(settings, start=settings.to, to=tmp_path / "more.safetensors", workspace=tmp_path / "more", samples=8)
    first_loss = read_card(settings.to).metrics["loss"]
    assert train_vpt_tob.main(again) == 0
    assert read_card(again.to).inputs == {"vpt-tob.safetensors": read_card(settings.to).sha256}
    assert read_card(again.to).metrics["loss"] < 1.5 * first_loss  # not from scratch
    capsys.readouterr()

    learn = train_vpn.TrainVpnSettings(
        data=dataset.folder, vpt_tob=settings.to, to=weights / "vpn.safetensors", images=64, epochs=2, threads=1
    )
    assert train_vpn.main(learn) == 0
    assert "caught in" in capsys.readouterr().out
    inference = Inference.of_weights(weights, batch=2, threads=1)
    assert np.isfinite(inference.answer(np.array([0]))[0]).all()

    results = tmp_path / "results"
    judged = evaluate.EvaluateSettings(
        data=dataset.folder, weights=weights, samples=(30, 60), horizons=(20, 40), to=results, threads=1
    )
    assert evaluate.main(judged) == 0
    report = json.loads(results.with_suffix(".json").read_text())
    assert list(report["methods"]) == ["vpt-tob", "caught-head"]
    assert not report["warnings"]
    assert len(report["results"]) == 8
    for result in report["results"]:
        for found in result["methods"].values():
            low, high = found["accuracy interval 95 %"]
            assert low <= found["accuracy"] <= high
            assert sum(part["examples"] for part in found["by horizon"].values()) == result["examples"]
    assert "majority class" in results.with_suffix(".md").read_text()
