"""Methods answer as their networks do when called one question at a time, and hazards make curves of survival."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import tyro
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from torch import Tensor, nn

from learning import train_caught, train_vpn, train_vpt_tob
from learning.dataset import Batch, Dataset, Samples
from learning.methods.machine import Machine
from learning.methods.method import Method
from learning.methods.survival import CERTAIN, TAIL, caught_logits
from learning.methods.table import METHODS, load_methods
from tests.learning.made_weights import play_dataset, save_untrained
from vantage.networks.hazard import caught_probability
from vantage.networks.weights import read_card

EXACT = Machine(torch.device("cpu"), torch.float32, 4, 2)
conditional = st.lists(st.floats(-8, 8), min_size=6, max_size=6)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return play_dataset(tmp_path_factory.mktemp("methods"))


@pytest.fixture(scope="module")
def weights(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, nn.Module]]:
    folder = tmp_path_factory.mktemp("weights")
    return folder, save_untrained(folder, dataset.hash)


@pytest.fixture(scope="module")
def methods(weights: tuple[Path, dict[str, nn.Module]]) -> dict[str, Method]:
    found, left_out = load_methods(METHODS, weights[0], EXACT)
    assert not left_out
    return {method.name: method for method in found}


@pytest.fixture(scope="module")
def samples(dataset: Dataset) -> Samples:
    return dataset.draw("train", 11, np.random.default_rng(0), symmetries=1)


def chance(logits: NDArray[np.float32]) -> NDArray[np.float64]:
    return 1 / (1 + np.exp(-logits.astype(np.float64)))


@given(conditional)
def test_hazards_at_checkpoints_and_between(logits: list[float]) -> None:
    z = np.array([logits])
    horizons = np.arange(0, 60)
    found = chance(caught_logits(np.repeat(z, 60, axis=0), horizons))
    at_checkpoints = caught_probability(torch.tensor(z))[0].numpy()
    np.testing.assert_allclose(found[9::10], at_checkpoints, atol=1e-5)
    survival = np.log1p(-np.concatenate([[0.0], at_checkpoints]))
    expected = -np.expm1(np.interp(horizons, [0, 9, 19, 29, 39, 49, 59], survival))
    np.testing.assert_allclose(found, np.clip(expected, chance(np.float32(-CERTAIN)), None), atol=1e-6)


@given(conditional, st.integers(60, 350))
def test_beyond_the_last_checkpoint_the_mean_hazard_of_the_last_ones_goes_on(logits: list[float], horizon: int) -> None:
    z = np.array([logits])
    hazard = chance(z[0, -TAIL:]).mean()
    survived = np.prod(1 - chance(z[0])) * (1 - hazard) ** ((horizon - 59) / 10)
    assert chance(caught_logits(z, np.array([horizon])))[0] == pytest.approx(1 - survived, abs=1e-5)


@given(st.lists(st.floats(-60, 60), min_size=6, max_size=6))
def test_the_chance_of_a_catch_never_falls_as_the_horizon_grows(logits: list[float]) -> None:
    horizons = np.arange(0, 351)
    found = caught_logits(np.tile(logits, (351, 1)), horizons)
    assert np.isfinite(found).all() and (np.diff(found) >= 0).all()
    assert found[0] == -CERTAIN


def pixels(images: NDArray[np.uint8]) -> Tensor:
    return torch.from_numpy(images).permute(0, 3, 1, 2).float() / 255


@torch.inference_mode()
def directly(name: str, networks: dict[str, nn.Module], batch: Batch) -> Tensor:
    files = METHODS[name].files
    network = networks[files[0]]
    image = pixels(batch.inputs)
    vector = torch.from_numpy(batch.vectors)
    if name.startswith("coordinate"):
        return network(image[:, :3], vector)
    if name == "caught-head":
        return network.forward_with_head(image)[1]  # type: ignore[operator]
    return networks[files[1]](network(image[:, :3], vector) if name == "vector-action" else network(image))


@pytest.mark.parametrize("name", [name for name in METHODS if not name.startswith("hazard")])
def test_a_method_answers_as_its_networks_do(
    name: str, methods: dict[str, Method], weights: tuple[Path, dict[str, nn.Module]], dataset: Dataset, samples: Samples
) -> None:
    expected = directly(name, weights[1], dataset.render(samples, vectors=True))
    found = methods[name].judge(dataset.questions(samples))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert np.ptp(found) > 1e-6  # it looks at what it is asked


@pytest.mark.parametrize("name", ["hazard", "hazard-attention"])
def test_a_hazard_network_is_asked_once_a_plan_and_shown_the_whole_of_it(
    name: str, methods: dict[str, Method], weights: tuple[Path, dict[str, nn.Module]], dataset: Dataset
) -> None:
    episode = np.flatnonzero(dataset.episodes["caught_step"] > 5)[:2]
    rows, horizons = np.repeat(episode, 13), np.tile(np.arange(0, 39, 3), 2)
    zero = np.zeros(26, np.int64)
    questions = dataset.questions(Samples(rows, zero, horizons, zero, dataset.caught(rows, horizons)))
    network, asked = weights[1][name], list[int]()
    method = methods[name]
    counter = method._network.register_forward_pre_hook(lambda _, shown: asked.append(len(shown[0])))  # type: ignore[attr-defined]
    found = method.judge(questions)
    counter.remove()
    assert asked == [EXACT.size]  # two plans, filled up to one part
    length = questions.last - questions.first
    assert (length == 40).all()
    whole = dataset.render(Samples(episode, zero[:2], length[:2], zero[:2], np.zeros(2, np.bool_)), vectors=True)
    images = pixels(whole.inputs)
    with torch.inference_mode():
        shown = (images,) if name == "hazard" else (images[:, :3], torch.from_numpy(whole.vectors))
        logits = network(*shown).numpy()
    np.testing.assert_allclose(found, caught_logits(np.repeat(logits, 13, axis=0), horizons), atol=1e-4)


@pytest.mark.parametrize("name", ["vpt-tob", "coordinate-path", "hazard", "hazard-attention"])
def test_an_answer_does_not_depend_on_what_else_is_asked(
    name: str, methods: dict[str, Method], weights: tuple[Path, dict[str, nn.Module]], dataset: Dataset, samples: Samples
) -> None:
    questions = dataset.questions(samples)
    together = methods[name].judge(questions)
    np.testing.assert_array_equal(methods[name].judge(questions), together)
    order = np.random.default_rng(1).permutation(len(questions))
    np.testing.assert_allclose(methods[name].judge(questions.chosen(order)), together[order], atol=1e-5)
    alone = [methods[name].judge(questions.chosen(np.array([row])))[0] for row in range(len(questions))]
    np.testing.assert_allclose(alone, together, atol=1e-5)
    one_thread = {method.name: method for method in load_methods([name], weights[0], replace(EXACT, threads=1))[0]}
    np.testing.assert_array_equal(one_thread[name].judge(questions), together)
    assert len(methods[name].judge(questions.chosen(np.zeros(0, np.int64)))) == 0


def test_questions_hold_what_samples_show(dataset: Dataset, samples: Samples) -> None:
    questions = dataset.questions(samples)
    assert len(questions) == len(samples)
    assert (questions.last - questions.first >= questions.horizons).all()
    assert len(np.unique(questions.view_of)) == len(questions.views) <= len(samples)
    rows = dataset.episodes[samples.episode]
    for number in range(len(samples)):
        step = dataset.steps[rows["first_step"][number] + samples.start[number]]
        x, y, heading = questions.positions[questions.first[number]]
        hider = step["hider"]  # it drives by the plan, but for what stood in its way
        assert np.hypot(x - hider["x"], y - hider["y"]) < 0.03
        assert abs(np.sin((heading - hider["heading"]) / 2)) < 0.1
        view = np.frombuffer(dataset.image(rows["first_step"][number] + samples.start[number], 0), np.uint8)
        np.testing.assert_array_equal(questions.views[questions.view_of[number]].ravel(), view)


def test_every_method_learnt_about_is_named_with_its_weights(
    methods: dict[str, Method], weights: tuple[Path, dict[str, nn.Module]]
) -> None:
    for name, method in methods.items():
        assert {file: card.sha256 for file, card in method.cards.items()} == {
            file: read_card(weights[0] / f"{file}.safetensors").sha256 for file in METHODS[name].files
        }


def test_what_is_missing_is_named_with_the_command_that_makes_it(tmp_path: Path, dataset: Dataset) -> None:
    found, left_out = load_methods(METHODS, tmp_path, EXACT)
    assert not found and len(left_out) == len(METHODS)
    mains = {"train vpt-tob": train_vpt_tob.TrainVptTobSettings, "train vpn": train_vpn.TrainVpnSettings}
    mains["train caught"] = train_caught.TrainCaughtSettings  # type: ignore[assignment]
    for name, row in METHODS.items():
        assert len(row.files) == len(row.training)
        for command in row.training:
            words = command.format(folder=tmp_path).split()
            tyro.cli(mains[" ".join(words[:2])], args=[*words[2:], "--to", str(tmp_path / "x.safetensors")])
        assert any(line.startswith(f"{name} left out") and "`vantage train " in line for line in left_out)
    save_untrained(tmp_path, dataset.hash)
    (tmp_path / "vector-action-vpn.safetensors").unlink()
    found, left_out = load_methods(METHODS, tmp_path, EXACT)
    assert len(found) == len(METHODS) - 1
    assert "vector-action-vpn.safetensors" in left_out[0] and "train vpn --views" in left_out[0]
