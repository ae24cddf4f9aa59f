"""Loads a data set with LeRobot's own loader and compares every frame with what the log says. Runs in LeRobot's environment.

python check_lerobot.py DATASET EXPECTED.npz: prints figures as JSON, or fails. EXPECTED holds, for each feature, the frames in
order (pictures uint8 [n, H, W, 3]), and `lengths` of the episodes. No part of Vantage is imported.
"""

import json
import sys

import numpy as np
from torch import library
from torch.utils.data import DataLoader


def import_loader():
    """LeRobotDataset. torchvision's compiled operators, which the loader does not need, may lack CUDA's libraries."""
    try:
        import torchvision  # noqa: F401
    except RuntimeError:
        for name in [name for name in sys.modules if name.startswith("torchvision")]:
            del sys.modules[name]
        for name in ("nms", "qnms"):
            library.define(f"torchvision::{name}", "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset


def main(root: str, expected_path: str) -> None:
    LeRobotDataset = import_loader()
    expected = dict(np.load(expected_path))
    lengths = expected.pop("lengths")
    dataset = LeRobotDataset("vantage/hide-and-seek", root=root)
    assert (dataset.num_episodes, len(dataset)) == (len(lengths), lengths.sum()), (dataset.num_episodes, len(dataset))
    ends = np.cumsum(lengths)
    for number, (end, length) in enumerate(zip(ends, lengths, strict=True)):
        episode = dataset.meta.episodes[number]
        assert (episode["dataset_from_index"], episode["dataset_to_index"]) == (end - length, end)
    values = 0
    for index in range(len(dataset)):
        frame = dataset[index]
        for name, frames in expected.items():
            found = frame[name].numpy()
            wanted = frames[index]
            if wanted.dtype == np.uint8 and wanted.ndim == 3:
                scaled = found.transpose(1, 2, 0) * 255
                found = np.rint(scaled).astype(np.uint8)
                assert np.abs(scaled - found).max() < 1e-3, name
            assert np.array_equal(found, wanted), (index, name, found, wanted)
            values += wanted.size
        episode = int(np.searchsorted(ends, index, side="right"))
        first = ends[episode] - lengths[episode]
        assert (frame["episode_index"].item(), frame["frame_index"].item()) == (episode, index - first)
        assert frame["next.done"].item() == (index == ends[episode] - 1)
        assert frame["task"] == "hide from the seeker"
    # Neighbours in time: at an episode's edge they are padded, never taken from another episode.
    step = 1 / dataset.fps
    queried = LeRobotDataset(
        "vantage/hide-and-seek", root=root, delta_timestamps={"observation.state": [-step, 0.0], "action": [0.0, step]}
    )
    for index in (0, int(ends[0]) - 1, int(ends[0]) % len(queried), len(queried) - 1):
        frame = queried[index]
        at_start, at_end = index in {0, *ends[:-1].tolist()}, index + 1 in ends
        assert frame["observation.state_is_pad"].tolist() == [at_start, False]
        assert frame["action_is_pad"].tolist() == [False, at_end]
        before = index if at_start else index - 1
        assert np.array_equal(frame["observation.state"][0].numpy(), expected["observation.state"][before])
    loader = DataLoader(queried, batch_size=8)
    batches = sum(len(batch["index"]) for batch in loader)
    assert batches == len(queried)
    assert set(dataset.meta.stats) == set(dataset.features)
    shown = {"episodes": len(lengths), "frames": len(dataset), "values": values, "features": len(dataset.features)}
    print(json.dumps(shown))


main(*sys.argv[1:])
