"""Table I: which examples are judged, what is said of the judgements, and how the page comes to people."""

import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from learning import evaluate
from learning.accuracy.examples import blind_logits, draw_examples, frequency_logits
from learning.accuracy.page import table_of
from learning.accuracy.report import judged
from learning.dataset import Dataset, Samples
from learning.evaluate import EvaluateSettings, UnusableSettings
from learning.measures import accuracy, area_under_roc
from learning.methods.table import METHODS
from learning.provenance import in_one_line, provenance
from tests.learning.made_weights import play_dataset, save_untrained
from vantage.output import AlreadyExists, refuse_existing

T = 40


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return play_dataset(tmp_path_factory.mktemp("evaluation"), steps=T)


def columns(samples: Samples) -> list[list[int]]:
    return [samples.episode.tolist(), samples.start.tolist(), samples.horizon.tolist(), samples.caught.tolist()]


def test_a_smaller_set_is_the_beginning_of_a_larger_one(dataset: Dataset) -> None:
    few, many = (draw_examples(dataset, "train", count, "uniform", T, 1) for count in (300, 2500))
    assert len(few) == 300 and len(many) == 2500
    assert columns(few) == columns(many.part(0, 300))
    assert columns(many.part(0, 500)) != columns(many.part(1000, 1500))
    assert columns(few) != columns(draw_examples(dataset, "train", 300, "uniform", T, 2))


def test_examples_are_of_their_split_upright_and_start_where_they_should(dataset: Dataset) -> None:
    for start in ("uniform", "first"):
        examples = draw_examples(dataset, "test", 1000, start, 30, 1)  # type: ignore[arg-type]
        assert set(examples.episode.tolist()) <= set(dataset.of_split("test").tolist())
        assert (examples.symmetry == 0).all() and examples.horizon.max() <= 29
        assert (examples.start == 0).all() == (start == "first")
        caught_step = dataset.episodes["caught_step"][examples.episode]
        assert ((caught_step < 0) | (examples.start < np.maximum(caught_step, 1))).all()


def test_who_looks_at_nothing_is_fitted_on_training_games_alone(dataset: Dataset) -> None:
    examples = draw_examples(dataset, "test", 200, "first", T, 1)
    constant, clock, step = blind_logits(dataset, examples, "first", T, 1)
    assert len(np.unique(constant)) == 1
    np.testing.assert_array_equal(clock > 0, examples.horizon >= step)
    caught_step = dataset.episodes["caught_step"][dataset.of_split("train")]
    caught = (caught_step[:, None] >= 0) & (caught_step[:, None] <= np.arange(T))  # every training game at every horizon
    right = [(caught == (np.arange(T) >= threshold)).mean() for threshold in range(T + 1)]
    assert right[step] == pytest.approx(max(right), abs=0.005)


def test_frequencies_of_simulations_keep_their_side_of_one_half() -> None:
    share = np.arange(11) / 10
    logits = frequency_logits(share, 10)
    assert np.isfinite(logits).all() and (np.diff(logits) > 0).all()
    np.testing.assert_array_equal(logits > 0, share > 0.5)


def test_what_is_said_of_each_method(dataset: Dataset) -> None:
    examples = draw_examples(dataset, "train", 400, "uniform", T, 1)
    generator = np.random.default_rng(0)
    logits = {
        name: (noise * generator.normal(size=count) + np.where(examples.caught[:count], 1, -1)).astype(np.float32)
        for name, noise, count in (("horizon only", 3.0, 400), ("vpt-tob", 1.0, 400), ("oracle", 0.1, 100))
    }
    report = judged(logits, dataset, examples, 1)
    for name, found in report.items():
        count = len(logits[name])
        truth, said = examples.caught[:count], logits[name] > 0
        assert found["examples"] == count
        assert found["accuracy"] == accuracy(said, truth)
        assert found["AUROC"] == area_under_roc(logits[name], truth)
        for kind in ("by horizon", "by hider"):
            parts = found[kind].values()
            assert sum(part["examples"] for part in parts) == count
            assert sum(part["examples"] * part["accuracy"] for part in parts) == pytest.approx(count * found["accuracy"])
            assert sum(part["examples"] * part["caught share"] for part in parts) == pytest.approx(truth.sum())
        first = found["by horizon"]["0..19"]
        assert first["examples"] == (examples.horizon[:count] < 20).sum()
        for reference, against in found["against"].items():
            other = (logits[reference][:count] > 0) == truth
            assert against["difference"] == pytest.approx(found["accuracy"] - other.mean())
            assert against["interval 95 %"][0] <= against["difference"] <= against["interval 95 %"][1]
    assert set(report["oracle"]["against"]) == {"horizon only", "vpt-tob"}
    assert set(report["vpt-tob"]["against"]) == {"horizon only"}


def test_the_whole_command(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights, to = tmp_path / "weights", tmp_path / "results" / "accuracy-0.9"
    save_untrained(weights, dataset.hash)
    (weights / "hazard.safetensors").unlink()
    card = json.loads((weights / "coordinate-end.json").read_text())
    card["data"]["hash"], card["training"]["samples"] = "another", 2000
    (weights / "coordinate-end.json").write_text(json.dumps(card))
    card = json.loads((weights / "vpn.json").read_text())
    (weights / "vpn.json").write_text(json.dumps({**card, "inputs": {"vpt-tob.safetensors": "another"}}))
    settings = EvaluateSettings(
        data=dataset.folder, weights=weights, samples=(10, 20), horizons=(20, T), oracle=2, oracle_samples=15, to=to, threads=1
    )
    assert evaluate.main(settings) == 0
    shown = capsys.readouterr()
    assert "hazard left out" in shown.err and "train caught --model hazard" in shown.err
    for warning in ("coordinate-end was trained on other data", "vpn did not learn from what", "different numbers of samples"):
        assert warning in shown.err
    assert max(map(len, shown.out.splitlines()[:-1])) <= 100  # the last line names files
    report = json.loads(to.with_name("accuracy-0.9.json").read_text(), parse_constant=lambda _: pytest.fail("no JSON"))
    assert [(found["start"], found["horizon limit"], found["examples"]) for found in report["results"]] == [
        (start, limit, count) for start in ("uniform", "first") for limit in (20, T) for count in (10, 20)
    ]
    names = ["majority class", "horizon only", *(n for n in METHODS if n not in ("hazard", "vpn-on-true")), "oracle"]
    for found in report["results"]:
        asked = [*names, "view oracle"] if found["start"] == "first" else names  # the layouts of these games are all random
        assert list(found["methods"]) == asked
        assert all(found["methods"][name]["examples"] == min(15, found["examples"]) for name in asked[len(names) - 1 :])
        assert found["methods"]["oracle"]["examples"] == min(15, found["examples"])
    assert report["methods"]["vpt-tob"]["weights"]["vpn"]["images"] == 50
    assert report["methods"]["vector-action"]["paper"] == 0.8298
    page = to.with_name("accuracy-0.9.md").read_text()
    assert all(f"| {name} |" in page for name in names)
    assert page.count("oracle: the first 15 examples only") == shown.out.count("oracle: the first 15 examples only") == 6
    assert page.count("view oracle: the first 15 examples only") == 2

    with pytest.raises(AlreadyExists, match=r"accuracy-0.9.json exists already: choose another --to.*--force"):
        evaluate.main(settings)
    refuse_existing(to.with_name("accuracy-0.9.json"), force=True)

    with pytest.raises(UnusableSettings, match="no method has its weights in"):
        evaluate.main(EvaluateSettings(data=dataset.folder, weights=tmp_path, to=None))
    for wrong in ({"methods": ("vpt",)}, {"samples": ()}, {"horizons": (0,)}, {"oracle": -1}):
        with pytest.raises(UnusableSettings):
            evaluate.main(EvaluateSettings(data=dataset.folder, weights=weights, **wrong))  # type: ignore[arg-type]


def test_ablations_judge_true_views(dataset: Dataset, tmp_path: Path) -> None:
    save_untrained(tmp_path, dataset.hash)
    to = tmp_path / "ablations"
    settings = EvaluateSettings(
        *(dataset.folder, tmp_path, ("vpt-tob",), (10,), (T,), ("first",)), ablations=True, to=to, threads=1
    )
    assert evaluate.main(settings) == 0
    (result,) = json.loads(to.with_suffix(".json").read_text())["results"]
    assert [*result["methods"]][2:] == ["vpt-tob", "vpn-on-true", "true views, vpn", "true views, vpn-on-true"]


def test_the_table_fits_80_columns() -> None:
    found = {
        "accuracy": 1.0,
        "accuracy interval 95 %": [0.9999, 1.0],
        "balanced accuracy": 1.0,
        "AUROC": None,
        "against": {"horizon only": {"difference": -0.2, "interval 95 %": [-0.251, -0.151]}},
    }
    names = dict.fromkeys([*METHODS, "majority class", "horizon only", "oracle"], found)
    result = {"start": "uniform", "horizon limit": 200, "examples": 10_000, "episodes": 500, "methods": names}
    wide = Console(width=200)
    with wide.capture() as capture:
        wide.print(table_of(result, {name: row.paper for name, row in METHODS.items()}))
    lines = capture.get().splitlines()
    assert max(len(line.rstrip()) for line in lines) <= 80
    assert any("88.45" in line for line in lines)


def test_provenance_says_what_ran_where() -> None:
    found = json.loads(json.dumps(provenance()))
    assert found["hardware"]["cores"] >= 1 and found["hardware"]["cpu"]
    assert found["torch"] in in_one_line(found)
