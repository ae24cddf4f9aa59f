"""Training end to end on real logs, small: it learns, goes on where it stopped, and its weights answer and are evaluated."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch._dynamo.exc import TorchDynamoException

from learning import evaluate, train_vpn, train_vpt_tob
from learning.collect import CollectSettings, play_block
from learning.compiling import to_compile
from learning.convert import convert
from learning.dataset import Dataset
from learning.group import Group
from learning.recipe import PRESETS, VPN_PRESETS, Recipe, VpnRecipe, notes_of, rate_factor
from learning.tensors import Tensors, tensors_of
from learning.train_vpt_tob import TrainVptTobSettings
from learning.trainer import Model, Trainer
from learning.training_identity import OtherTraining
from learning.training_settings import UnusableTraining
from vantage.networks.inference import Inference
from vantage.networks.vpt_tob import VptTob, VptTobSettings
from vantage.networks.weights import UnusableWeights, load, read_card

ALONE = Group(0, 1, torch.device("cpu"))
SMALL = replace(PRESETS["compact"], network=VptTobSettings(width=0.25, whole_image=True, caught_head=True), batch=8)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("training")
    settings = CollectSettings(hider="goal-walk", seed=52, steps=40)  # seeds of all three splits
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
    assert notes_of(recipe) == ["The paper's network.", "The paper's recipe."]
    assert replace(PRESETS["whole-image"], network=VptTobSettings()) == recipe
    assert PRESETS["whole-image"].network == VptTobSettings(whole_image=True)
    vpn = VPN_PRESETS["paper"]
    assert vpn == VpnRecipe(images=2000, epochs=100, batch=256, rate=5e-4, symmetries=4, held=400, stream=False)
    assert [rate_factor(vpn, progress) for progress in (0.19, 0.2, 0.5)] == pytest.approx([1, 0.9, 0.81])


@pytest.mark.parametrize("drop", [0.9, 0.5, 0.1])
def test_the_readings_of_the_learning_rate_are_settings_and_told(drop: float) -> None:
    settings = TrainVptTobSettings(preset="compact", schedule="steps", drop=drop)
    recipe = train_vpt_tob.resolve(settings)
    assert [rate_factor(recipe, progress) for progress in (0.0, 0.3, 0.7)] == pytest.approx([1, drop, drop**2])
    assert any(f"times {drop:g}" in note for note in notes_of(recipe)) is (drop != 0.9)


def rendered(dataset: Dataset, number: int, model: Model = "vpt-tob") -> Tensors:
    samples = dataset.draw("train", 8, np.random.default_rng(number))
    target = "hider" if model == "self-perspective" else "seeker"
    return tensors_of(dataset.render(samples, target, model == "vector-action"), ALONE.device)


PLAIN = Recipe(network=VptTobSettings(width=0.25), batch=8)


@pytest.mark.parametrize(
    ("model", "recipe"),
    [("vpt-tob", SMALL), ("vpt-tob", PLAIN), ("self-perspective", PLAIN), ("vector-action", PLAIN), ("vector-action", SMALL)],
)
def test_it_learns_one_batch_by_heart(dataset: Dataset, model: Model, recipe: Recipe) -> None:
    trainer = Trainer(model, recipe, ALONE, compiled=False, seed=0)
    batch = rendered(dataset, 0, model)
    losses = [float(trainer.learn(batch, 3.0)) for _ in range(20)]
    assert losses[-1] < 0.6 * losses[0]
    assert trainer.network.architecture == model


def test_where_compiling_fails_training_goes_on_without(dataset: Dataset, capsys: pytest.CaptureFixture[str]) -> None:
    trainer, plain = (Trainer("vpt-tob", PLAIN, ALONE, compiled=False, seed=0) for _ in range(2))

    def failing(batch: Tensors) -> object:
        raise TorchDynamoException("no such compiler\nand many lines more")

    trainer.forward_in_training = failing  # type: ignore[assignment]
    losses = [[float(one.learn(rendered(dataset, number), 1.0)) for number in range(2)] for one in (trainer, plain)]
    assert losses[0] == losses[1]
    assert capsys.readouterr().out == "going on without compiling, it failed: no such compiler\n"


def test_a_restored_trainer_goes_on_as_if_never_stopped(dataset: Dataset) -> None:
    batches = [rendered(dataset, number) for number in range(4)]
    straight = Trainer("vpt-tob", SMALL, ALONE, compiled=False, seed=0)
    for batch in batches[:2]:
        straight.learn(batch, 1.0)
    state = straight.state()
    resumed = Trainer("vpt-tob", SMALL, ALONE, compiled=False, seed=5)
    resumed.restore({name: None if part is None else _copied(part) for name, part in state.items()})
    for batch in batches[2:]:
        assert float(straight.learn(batch, 0.5)) == float(resumed.learn(batch, 0.5))


def tags(workspace: Path) -> set[str]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    found = EventAccumulator(str(workspace)).Reload().Tags()
    return {*found["scalars"], *found["images"]}


def _copied(state: dict[str, object]) -> dict[str, object]:
    import copy

    return copy.deepcopy(state)


@pytest.mark.parametrize("symmetries", [1, 8])
def test_the_hiders_own_later_view_is_a_target_of_its_own(dataset: Dataset, symmetries: int) -> None:
    samples = dataset.draw("train", 16, np.random.default_rng(0), symmetries=symmetries)
    now = dataset.render(replace(samples, horizon=np.zeros_like(samples.horizon)), "hider")
    np.testing.assert_array_equal(now.targets, now.inputs[..., :3])  # its view after no step is its view
    seekers, hiders = dataset.render(samples), dataset.render(samples, "hider")
    np.testing.assert_array_equal(hiders.inputs, seekers.inputs)
    assert (hiders.targets != seekers.targets).any(axis=(1, 2, 3)).all()
    caught = dataset.episodes["caught_step"][samples.episode]
    late = np.flatnonzero(samples.caught)
    at_catch = dataset.render(replace(samples, horizon=np.where(samples.caught, caught - samples.start, 0)), "hider")
    assert late.size
    np.testing.assert_array_equal(hiders.targets[late], at_catch.targets[late])  # frozen


def test_a_baseline_is_trained_judged_and_never_taken_for_vpt_tob(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PRESETS, "paper", PLAIN)
    settings = TrainVptTobSettings(
        model="self-perspective", data=dataset.folder, samples=8, validation=16, to=tmp_path / "vpt-tob.safetensors", threads=1
    )
    assert train_vpt_tob.main(replace(settings, workspace=tmp_path / "run")) == 0
    card = read_card(tmp_path / "vpt-tob.safetensors")
    assert (card.architecture, card.training["target"]) == ("self-perspective", "the hider's view")
    vpn = train_vpn.TrainVpnSettings(
        data=dataset.folder,
        views=tmp_path / "vpt-tob.safetensors",
        to=tmp_path / "vpn.safetensors",
        images=32,
        epochs=1,
        threads=1,
    )
    assert train_vpn.main(replace(vpn, workspace=tmp_path / "vpn")) == 0
    assert read_card(tmp_path / "vpn.safetensors").inputs == {"vpt-tob.safetensors": card.sha256}
    with pytest.raises(UnusableWeights, match="holds a self-perspective network, wanted is vpt-tob"):
        Inference.of_weights(tmp_path)


def test_compiling_is_for_long_trainings_where_there_is_a_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cpu = torch.device("cpu")
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    chosen, why = to_compile("auto", cpu, 800_000, None)
    assert not chosen and "a C++ compiler is missing" in why
    compiler = tmp_path / "g++"
    compiler.write_text("#!/bin/sh\n")
    compiler.chmod(0o755)
    assert to_compile("auto", cpu, 800_000, None)[0] and to_compile("auto", cpu, 0, 60.0)[0]
    assert not to_compile("auto", cpu, 5_000, None)[0] and not to_compile("auto", cpu, 800_000, 2.0)[0]
    assert to_compile("on", cpu, 1, None)[0] and not to_compile("off", cpu, 800_000, None)[0]


def test_a_stream_shows_fresh_views_and_a_fixed_set_each_once_an_epoch(dataset: Dataset) -> None:
    views = train_vpn.Views(dataset, None, ALONE.device)
    fixed = VpnRecipe(images=20, batch=8, on="true")
    parts = [batch for batch, _ in zip(train_vpn.repeated(views, fixed, 1, 0), range(6), strict=False)]
    images = torch.cat([shown for shown, _ in parts]).flatten(1)
    assert [len(shown) for shown, _ in parts] == [8, 8, 4, 8, 8, 4]
    assert sorted(map(hash, map(bytes, images[:20].numpy()))) == sorted(map(hash, map(bytes, images[20:].numpy())))
    assert not torch.equal(images[:20], images[20:])
    later = next(train_vpn.repeated(views, fixed, 1, 28))  # resumed
    assert torch.equal(later[0], parts[4][0])
    stream = train_vpn.streamed(views, replace(fixed, stream=True, epochs=2, pool=32), 1, 0)
    shown, caught = zip(*(batch for batch, _ in zip(stream, range(40), strict=False)), strict=True)
    assert {len(batch) for batch in shown} == {8}
    assert len({bytes(image) for image in torch.cat(shown).flatten(1).numpy()}) > 60  # of 320, far more than the pool holds
    assert 0 < float(torch.cat(caught).mean()) < 1


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
        validation=64,
        threads=1,
    )
    assert train_vpt_tob.main(settings) == 0
    network, card = load(settings.to, VptTob)
    assert network.settings == SMALL.network
    assert card.data["hash"] == dataset.hash
    assert card.training["samples"] <= 96
    assert any("Not the paper's network" in note for note in card.notes)
    assert (tmp_path / "run" / "latest.png").stat().st_size > 10_000
    assert {"validation/loss", "training/loss", "predictions"} <= tags(tmp_path / "run")
    printed = capsys.readouterr().out
    assert "50.0 %" in printed and "100.0 %" in printed and "min left" in printed

    assert train_vpt_tob.main(replace(settings, samples=144)) == 0  # goes on from the checkpoint
    assert "going on after 96 samples" in capsys.readouterr().out
    with pytest.raises(OtherTraining, match=r"is of another training \(recipe disc_weight 8.0 there, 2.0 here\)"):
        train_vpt_tob.main(replace(settings, disc_weight=2.0))

    there = replace(settings, resident="on", to=tmp_path / "there.safetensors", workspace=tmp_path / "there")
    assert train_vpt_tob.main(there) == 0  # rendered in the device's memory: the same training
    assert read_card(there.to).metrics["loss"] == pytest.approx(card.metrics["loss"], rel=1e-5)
    assert "rendered there" in capsys.readouterr().out

    again = replace(settings, start=settings.to, to=tmp_path / "more.safetensors", workspace=tmp_path / "more", samples=8)
    first_loss = read_card(settings.to).metrics["loss"]
    assert train_vpt_tob.main(again) == 0
    assert read_card(again.to).inputs == {"vpt-tob.safetensors": read_card(settings.to).sha256}
    assert read_card(again.to).metrics["loss"] < 1.5 * first_loss  # not from scratch
    with pytest.raises(UnusableTraining, match="holds another network than the preset"):
        train_vpt_tob.main(replace(again, head_weight=0.0))

    learn = train_vpn.TrainVpnSettings(
        data=dataset.folder,
        views=settings.to,
        to=weights / "vpn.safetensors",
        preset="compact",
        images=1024,
        epochs=1,
        report_every=512,
        validation=64,
        workspace=tmp_path / "vpn",
        threads=1,
    )
    assert train_vpn.main(learn) == 0
    assert "a stream of 1,024 predictions" in capsys.readouterr().out
    assert train_vpn.main(replace(learn, images=1280)) == 0  # goes on from the checkpoint
    assert "going on after 1,024 images" in capsys.readouterr().out
    assert read_card(learn.to).inputs == {"vpt-tob.safetensors": read_card(settings.to).sha256}
    assert "validation/accuracy" in tags(tmp_path / "vpn")
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


@pytest.mark.parametrize("words", ["train vpt-tob", "train vpn", "train caught"])
def test_a_mistake_under_torchrun_is_one_line(words: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "vantage.cli", *words.split(), "--data", str(tmp_path / "none")]  # as torchrun starts it
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert run.stderr.startswith(f"vantage {words}: {tmp_path / 'none'} holds no training set") and run.stderr.count("\n") == 1
