"""Trainings that differ by their seed: different networks with true cards, found by these, and their spread in every table."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning import evaluate, train_caught, train_vpn
from learning.accuracy.report import judged, spread
from learning.dataset import Dataset
from learning.evaluate import EvaluateSettings
from learning.methods.trainings import Training, trainings_of, weights_folder
from learning.recipe import CAUGHT_PRESETS, VPN_PRESETS
from learning.train_caught import TrainCaughtSettings
from learning.train_vpn import TrainVpnSettings, name_of, views_of
from learning.training_settings import Place, UnusableTraining
from learning.value_maps.report import ONE_SIMULATION, arrays, by_seed, played, ranking
from tests.learning.made_weights import NARROW, play_dataset, untrained
from tests.learning.test_value_maps import results, some_cases
from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.weights import card_of, load_any, read_card, save

T = 40


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return play_dataset(tmp_path_factory.mktemp("seeds"), steps=T)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.set_num_threads(1)
    monkeypatch.setitem(CAUGHT_PRESETS, "compact", replace(CAUGHT_PRESETS["compact"], encoder=NARROW, batch=8))
    monkeypatch.setitem(VPN_PRESETS, "compact", replace(VPN_PRESETS["compact"], held=32, batch=8, pool=64))


def test_two_seeds_are_two_networks_in_one_command_and_one_row_with_their_spread(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = tmp_path / "runs"
    settings = TrainCaughtSettings(
        model="hazard",
        data=dataset.folder,
        to=weights / "hazard.safetensors",
        preset="compact",
        samples=32,
        report_every=16,
        validation=32,
        threads=1,
        compile="off",
        seeds=(1, 2),
    )
    assert train_caught.main(settings) == 0
    networks, cards = zip(*(load_any(weights / f"hazard-seed{seed}.safetensors") for seed in (1, 2)), strict=True)
    assert [card.training["seed"] for card in cards] == [1, 2]
    assert all(card.training["samples"] == 32 and card.data["hash"] == dataset.hash for card in cards)
    assert cards[0].identity != cards[1].identity
    pairs = zip(networks[0].parameters(), networks[1].parameters(), strict=True)
    assert all(not torch.equal(a, b) for a, b in pairs if a.ndim > 1)
    assert (weights / "hazard-seed1/checkpoint.pt").exists() and (weights / "hazard-seed2/checkpoint.pt").exists()

    assert train_caught.main(replace(settings, seeds=(2,), to=tmp_path / "alone.safetensors")) == 0
    assert read_card(tmp_path / "alone.safetensors").sha256 == cards[1].sha256, "a seed is a seed, however it is asked for"
    capsys.readouterr()
    assert train_caught.main(settings) == 0
    shown = capsys.readouterr()
    assert shown.out.count("nothing left to train") == 2 and not shown.err

    asked = EvaluateSettings(
        data=dataset.folder, weights=weights, methods=("hazard",), samples=(40,), horizons=(T,), to=tmp_path / "r", threads=1
    )
    assert evaluate.main(asked) == 0
    assert "n = 2" in capsys.readouterr().out
    report = json.loads((tmp_path / "r.json").read_text())
    assert [seen["seed"] for seen in report["methods"]["hazard"]["weights"].values()] == [1, 2]
    found = [result["methods"]["hazard"] for result in report["results"]]
    for result in found:
        values = result["over seeds"]["values"]
        assert result["accuracy"] == pytest.approx(np.mean(values)) and result["over seeds"]["n"] == 2
    assert "n = 2" in (tmp_path / "r.md").read_text() and "| hazard-seed2 | compact | 2 |" in (tmp_path / "r.md").read_text()
    for seed in (1, 2):
        one = tmp_path / f"only{seed}"
        save(networks[seed - 1], one / "hazard.safetensors", cards[seed - 1])
        assert evaluate.main(replace(asked, weights=one, to=tmp_path / "one", force=True)) == 0
        single = json.loads((tmp_path / "one.json").read_text())["results"]
        assert [result["over seeds"]["values"][seed - 1] for result in found] == pytest.approx(
            [result["methods"]["hazard"]["accuracy"] for result in single]
        )
        assert "over seeds" not in single[0]["methods"]["hazard"]


def test_the_judge_of_each_seed_learns_from_the_predictor_of_that_seed(dataset: Dataset, tmp_path: Path) -> None:
    networks = untrained()
    for stem in ("vpt-tob-seed1", "vpt-tob-seed2"):
        save(networks["vpt-tob"], tmp_path / f"{stem}.safetensors", card_of(networks["vpt-tob"]))  # type: ignore[arg-type]
        networks["vpt-tob"].ups[0].up.weight.data += 0.01  # type: ignore[index, union-attr]
    settings = TrainVpnSettings(
        data=dataset.folder,
        views=tmp_path / "vpt-tob.safetensors",
        to=tmp_path / "vpn.safetensors",
        preset="compact",
        images=128,
        epochs=1,
        threads=1,
        seeds=(1, 2),
    )
    assert train_vpn.main(settings) == 0
    trainings, left_out = trainings_of(("vpt-tob", "vpn"), tmp_path)
    assert not left_out
    assert [[path.stem for path in one.files] for one in trainings] == [[f"vpt-tob-seed{n}", f"vpn-seed{n}"] for n in (1, 2)]
    for one in trainings:
        assert list(one.cards[1].inputs.values()) == [one.cards[0].sha256]
    with pytest.raises(UnusableTraining, match=r"no weights at .*vpt-tob-seed3"):
        views_of(replace(settings, seeds=(1, 3)), Place(3, tmp_path / "x.safetensors", tmp_path))
    one_predictor = replace(settings, views=tmp_path / "vpt-tob-seed1.safetensors")
    assert views_of(one_predictor, Place(2, tmp_path / "x", tmp_path)) == one_predictor.views
    alone = replace(settings, seeds=(2,))
    assert views_of(alone, Place(2, tmp_path / "x", tmp_path)) == tmp_path / "vpt-tob-seed2.safetensors"
    settings.views.write_bytes((tmp_path / "vpt-tob-seed1.safetensors").read_bytes())  # type: ignore[union-attr]
    assert views_of(alone, Place(2, tmp_path / "x", tmp_path)) == settings.views


@pytest.mark.parametrize(
    ("views", "name"),
    [("vpt-tob", "vpn"), ("vpt-tob-seed2", "vpn-seed2"), ("vector-action", "vector-action-vpn"), ("a-seed3", "a-vpn-seed3")],
)
def test_a_judge_is_named_after_what_it_judges(views: str, name: str) -> None:
    assert name_of(Path("runs", f"{views}.safetensors")) == name


def made(folder: Path, stem: str, **training: Any) -> None:
    card = card_of(Vpn(VpnSettings(width=4, hidden=8)))
    card.preset, card.data, card.training = "compact", {"hash": "h"}, {"samples": 1000, "rate": 0.001, "seed": 1, **training}
    save(Vpn(VpnSettings(width=4, hidden=8)), folder / f"{stem}.safetensors", card)


def test_only_what_differs_by_its_seed_alone_is_put_together(tmp_path: Path) -> None:
    made(tmp_path, "n", seed=5, minutes=3.0)
    made(tmp_path, "n-seed2", seed=2, samples=1050, minutes=2.0, device="cuda")
    made(tmp_path, "n-seed10", seed=10)
    made(tmp_path, "n-seed3", seed=3, samples=500)
    made(tmp_path, "n-seed4", seed=4, rate=0.01)
    made(tmp_path, "n-seed5", seed=5)
    made(tmp_path, "n-seedling")
    made(tmp_path, "other-seed2", seed=2)
    trainings, left_out = trainings_of(("n",), tmp_path)
    assert [(one.files[0].stem, one.seed) for one in trainings] == [("n", "5"), ("n-seed2", "2"), ("n-seed10", "10")]
    assert left_out == [
        "n-seed3 left out: it differs from n by more than its seed (samples)",
        "n-seed4 left out: it differs from n by more than its seed (rate)",
        "n-seed5 left out: seed 5 is there already",
    ]


def test_weights_are_read_from_where_the_last_training_left_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (weights_folder(None) / "vpt-tob.safetensors").exists(), "those of this release"
    made(tmp_path / "runs", "hazard")
    assert weights_folder(None) == Path("runs") and weights_folder(Path("weights")) == Path("weights")


def test_figures_over_seeds_are_means_and_the_interval_is_that_of_the_mean(dataset: Dataset) -> None:
    from learning.accuracy.examples import draw_examples

    examples = draw_examples(dataset, "train", 300, "uniform", T, 1)
    generator = np.random.default_rng(0)
    signal = np.where(examples.caught, 1.0, -1.0)
    answers = np.stack([noise * generator.normal(size=300) + signal for noise in (0.5, 1.0, 4.0)]).astype(np.float32)
    found = judged({"horizon only": answers[2], "hazard": answers}, dataset, examples, 1)["hazard"]
    alone = [judged({"hazard": one}, dataset, examples, 1)["hazard"] for one in answers]
    assert found["accuracy"] == pytest.approx(np.mean([one["accuracy"] for one in alone]))
    assert found["AUROC"] == pytest.approx(np.mean([one["AUROC"] for one in alone]))
    assert found["over seeds"] == spread([one["accuracy"] for one in alone])
    assert found["over seeds"]["range"] == [min(found["over seeds"]["values"]), max(found["over seeds"]["values"])]
    low, high = found["accuracy interval 95 %"]
    assert low < found["accuracy"] < high
    same = judged({"hazard": np.stack([answers[0]] * 3)}, dataset, examples, 1)["hazard"]
    for key in ("accuracy", "accuracy interval 95 %", "balanced accuracy", "AUROC"):
        assert same[key] == pytest.approx(alone[0][key]), "three times the same training is that training"
    assert same["over seeds"]["sd"] == pytest.approx(0, abs=1e-9)


def test_value_maps_of_several_seeds_are_ranked_one_by_one_and_averaged() -> None:
    cases, horizons = some_cases(), (30, 60)
    maps = results(cases, horizons)["maps"]
    one = maps["vpt-tob, expected"]
    other = np.where(np.isnan(one), np.nan, np.random.default_rng(3).permutation(one.ravel()[~np.isnan(one.ravel())]).mean())
    other = other + np.random.default_rng(4).normal(size=one.shape)
    both = {**maps, "vpt-tob, expected": np.stack([one, other])}
    found, first, second = (
        ranking(cases, horizons, each, "vpt-tob", 1)["60"][ONE_SIMULATION]["vpt-tob, expected"]["without_ties"]
        for each in (both, maps, {**maps, "vpt-tob, expected": other})
    )
    assert found["mean"] == pytest.approx((first["mean"] + second["mean"]) / 2)
    assert found["over seeds"]["values"] == pytest.approx([first["mean"], second["mean"]])
    assert "over seeds" not in first
    fared = [
        played(cases, horizons, each, "vpt-tob", 1)["60"]["vpt-tob, expected"]["survival"]
        for each in (both, maps, {**maps, "vpt-tob, expected": other})
    ]
    assert fared[0]["over seeds"]["values"] == pytest.approx([fared[1]["mean"], fared[2]["mean"]])
    assert fared[0]["mean"] == pytest.approx((fared[1]["mean"] + fared[2]["mean"]) / 2)
    values = arrays(cases, horizons, both)["values"]
    np.testing.assert_allclose(values, arrays(cases, horizons, maps)["values"], equal_nan=True)
    assert by_seed(one).shape == (1, *one.shape)


def test_a_training_of_two_networks_names_both_seeds(tmp_path: Path) -> None:
    made(tmp_path, "a", seed=1)
    made(tmp_path, "b", seed=2)
    cards = tuple(read_card(tmp_path / f"{stem}.safetensors") for stem in "ab")
    assert Training((), cards).seed == "1/2" and Training((), (cards[0], cards[0])).seed == "1"
    assert asdict(cards[0])["identity"] == ""
