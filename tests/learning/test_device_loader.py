"""The device loader renders what `Dataset.render` renders, pixel for pixel, here with the CPU as the device."""

import lz4.block
import numpy as np
import pytest
import torch

from learning.dataset import EPISODE, PLAN, STEP, Dataset, Samples
from learning.device_loader import DeviceDataset, needed_bytes
from learning.tensors import tensors_of
from tests.learning.made_weights import play_dataset

CPU = torch.device("cpu")
T = 60


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return play_dataset(tmp_path_factory.mktemp("device"), steps=T)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Eight episodes of noise for images and paths nobody would drive: long waits, turns on the spot, walls, beyond, nowhere."""
    generator, steps = np.random.default_rng(0), 460
    paths = np.empty((8, steps, 3), np.float32)
    paths[..., 2] = generator.uniform(-3.2, 3.2, (8, steps))  # turning
    paths[0, :, :2] = 0.6  # waiting for longer than the scales reach
    paths[1, :, :2] = generator.uniform(-0.1, 1.3, (steps, 2))  # jumps, some beyond the walls
    paths[2, :, :2] = np.stack([np.linspace(0, 1.2, steps), np.zeros(steps)], 1)  # along a wall
    paths[3, :, :2] = np.stack([np.full(steps, 1.2), np.linspace(1.2, 0, steps)], 1)
    paths[4, :, :2] = np.arange(128)[generator.integers(128, size=(steps, 2))] * (1.2 / 128)  # on the edges of pixels
    paths[5, :, :2] = 0.3 + np.abs(np.arange(steps) % 40 - 20)[:, None] * 0.01  # forth and back over the same pixels
    paths[6, :, :2] = generator.choice([0.0, 1.2, -5.0, 5.0, 0.009375], (steps, 2))  # corners
    paths[7, :, :2] = 0.6 + np.cumsum(generator.normal(0, 0.01, (steps, 2)), 0)
    folder = tmp_path_factory.mktemp("made")
    episodes, recorded, plans = np.zeros(8, EPISODE), np.zeros(8 * steps, STEP), np.zeros(8, PLAN)
    episodes["first_step"], episodes["steps"], episodes["horizon"] = np.arange(8) * steps, steps, steps - 1
    episodes["caught_step"] = [-1, 100, -1, 3, 0, -1, 459, -1]
    recorded["plan"] = np.repeat(np.arange(8), steps)
    plans["first_position"], plans["positions"] = np.arange(8) * steps, steps
    images = [lz4.block.compress(generator.integers(5, size=128 * 128, dtype=np.uint8), store_size=False) for _ in range(64)]
    images = [images[number] for number in generator.integers(64, size=16 * steps)]
    np.save(folder / "episodes.npy", episodes)
    np.save(folder / "steps.npy", recorded)
    np.save(folder / "plans.npy", plans)
    np.save(folder / "positions.npy", paths.reshape(-1, 3))
    np.save(folder / "offsets.npy", np.concatenate([[0], np.cumsum([len(image) for image in images])]))
    (folder / "images.lz4").write_bytes(b"".join(images))
    (folder / "manifest.json").write_text('{"schema_version": 1, "hash": "made"}')
    return Dataset(folder)


@pytest.fixture(scope="module")
def made_on_device(made: Dataset) -> DeviceDataset:
    return DeviceDataset(made, CPU)


@pytest.fixture(scope="module")
def played_on_device(played: Dataset) -> DeviceDataset:
    return DeviceDataset(played, CPU)


def assert_equal(data: Dataset, device: DeviceDataset, samples: Samples, target: str = "seeker") -> None:
    expected = tensors_of(data.render(samples, target, vectors=True), CPU)  # type: ignore[arg-type]
    found = device.render(samples, target, vectors=True)  # type: ignore[arg-type]
    for name, mine, theirs in zip(expected._fields, found, expected, strict=True):
        assert mine.dtype == theirs.dtype and mine.shape == theirs.shape, name
        assert torch.equal(mine, theirs), name


@pytest.mark.parametrize("target", ["seeker", "hider"])
def test_drawn_samples_of_real_games(played: Dataset, played_on_device: DeviceDataset, target: str) -> None:
    samples = played.draw("train", 150, np.random.default_rng(0))
    assert set(samples.symmetry.tolist()) == set(range(8)) and samples.caught.sum() > 5
    assert_equal(played, played_on_device, samples, target)
    assert played_on_device.render(samples).vectors.shape == (150, 0)


@pytest.mark.parametrize("symmetry", range(8))
def test_every_symmetry_of_paths_nobody_would_drive(made: Dataset, made_on_device: DeviceDataset, symmetry: int) -> None:
    generator = np.random.default_rng(symmetry)
    episode = np.repeat(np.arange(8), 5)
    horizon = np.tile([0, 1, 10, 57, 400], 8)
    start = np.where(made.episodes["caught_step"][episode] == 0, 0, generator.integers(3, size=40))
    caught = made.caught(episode, start + horizon)
    assert_equal(made, made_on_device, Samples(episode, start, horizon, np.full(40, symmetry), caught))


def test_positions_that_are_not_finite_are_drawn_nowhere(made: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    positions = made.positions.copy()
    positions[3:9, 0], positions[20, 1] = np.nan, np.inf
    monkeypatch.setattr(made, "positions", positions)
    zero = np.zeros(3, np.int64)
    samples = Samples(zero, zero, np.array([2, 30, 5]), np.array([0, 5, 3]), np.zeros(3, np.bool_))
    expected, found = made.render(samples).inputs, DeviceDataset(made, CPU).render(samples).inputs
    np.testing.assert_array_equal(found.numpy(), expected)


def test_a_path_that_ends_before_its_horizon_is_refused(made_on_device: DeviceDataset) -> None:
    last = Samples(np.array([7]), np.array([400]), np.array([60]), np.array([0]), np.array([False]))
    with pytest.raises(ValueError, match="horizon"):
        made_on_device.render(last)


def test_the_memory_it_takes_is_told_beforehand(played: Dataset, played_on_device: DeviceDataset) -> None:
    held = [value for value in vars(played_on_device).values() if isinstance(value, torch.Tensor) and value.shape[0] > 1000]
    assert sum(tensor.numel() * tensor.element_size() for tensor in held) == needed_bytes(played)


def test_a_batch_of_none_and_one(played: Dataset, played_on_device: DeviceDataset) -> None:
    samples = played.draw("train", 1, np.random.default_rng(3))
    assert_equal(played, played_on_device, samples)
    assert_equal(played, played_on_device, samples.part(0, 0))
