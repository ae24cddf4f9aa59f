"""What a frame of our LeRobot data set holds, and how LeRobot, Hugging Face's `datasets` and Parquet name it."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Literal

from schemas import PRIMITIVES, ROBOTS, STATE_IMAGE_SIZE, Robot

CODEBASE_VERSION = "v3.0"
ROBOT_TYPE = "vantage"
"""What tells our data sets from those of others."""
TASK = "hide from the seeker"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
CHUNK_SIZE = 1000
"""Files of a folder."""
FILE_SIZE = 100
"""MB after which a new file begins."""

Feature = dict[str, Any]

_MEANINGS = (
    ("`observation.images.hider_color`", "observation.images.hider_color", "first-person colour of the hider, PNG, lossless"),
    ("`observation.images.hider_view`", "observation.images.hider_view", "the hider's state image in the colours of its palette"),
    (
        "`observation.depth.hider`",
        "observation.depth.hider",
        "uint16 [height, width], mm along the optical axis, 0 = no return; no PNG: see below",
    ),
    (
        "`privileged.images.seeker_color`, `..seeker_view`, `privileged.depth.seeker`",
        "privileged.images.seeker_color",
        "the same of the seeker (the state image if all games have it); no input for a hider's policy",
    ),
)
"""Of features that not every data set has: how the card calls them, what has to be there, and what they are."""


@dataclass(frozen=True)
class Choice:
    """What comes into a data set beside what the hider can know of games with catching.

    Attributes:
        seeker_pictures: what the seeker sees.
        without_catching: games whose rules ignore catches.
        rate: only games of this rate, steps per second (0: as fast as the players answered); None = all, if they have one rate.
    """

    seeker_pictures: bool = False
    without_catching: bool = False
    rate: float | None = None


PLAIN = Choice()
"""What the hider can know, of games with catching."""


def picture_robots(choice: Choice) -> tuple[Robot, ...]:
    """Return whose pictures a data set holds."""
    return ROBOTS if choice.seeker_pictures else ("hider",)


def picture_name(robot: Robot, part: Literal["color", "view"]) -> str:
    """Return the name of a picture's feature."""
    return f"{'observation' if robot == 'hider' else 'privileged'}.images.{robot}_{part}"


def depth_name(robot: Robot) -> str:
    """Return the name of a depth picture's feature."""
    return f"{'observation' if robot == 'hider' else 'privileged'}.depth.{robot}"


def features_of(sizes: dict[Robot, tuple[int, int]], views: bool, choice: Choice) -> dict[str, Feature]:
    """Return the features of a data set, by name, in the order of its columns.

    LeRobot (`dataset_to_policy_features`, 0.4) gives a policy every feature of dtype `image`, whatever its name, and all whose
    name begins with `observation` or `action`. So what the hider cannot know stands below `privileged.`, and its pictures are
    there only when asked for.

    Args:
        sizes: robot -> height, width of its pictures.
        views: whether state images are there.
        choice: whether the seeker's pictures are there.
    """
    robots = picture_robots(choice)
    features: dict[str, Feature] = {}
    for robot in robots:
        features[picture_name(robot, "color")] = _picture(*sizes[robot])
    for robot in robots if views else ():
        features[picture_name(robot, "view")] = _picture(STATE_IMAGE_SIZE, STATE_IMAGE_SIZE)
    for robot in robots:
        features[depth_name(robot)] = {"dtype": "uint16", "shape": list(sizes[robot]), "names": ["height", "width"]}
    pose = {"dtype": "float32", "shape": [3], "names": ["x", "y", "heading"]}
    primitive = {"dtype": "float32", "shape": [len(PRIMITIVES)], "names": list(PRIMITIVES)}
    features["observation.state"] = pose
    features["action"] = primitive
    features["privileged.seeker_state"] = pose
    features["privileged.seeker_action"] = primitive
    for name, kind in (("next.done", "bool"), ("next.success", "bool"), ("capture_time_ns", "int64"), ("timestamp", "float32")):
        features[name] = {"dtype": kind, "shape": [1], "names": None}
    for name in ("frame_index", "episode_index", "index", "task_index"):
        features[name] = {"dtype": "int64", "shape": [1], "names": None}
    return features


def is_picture(feature: Feature) -> bool:
    """Whether a feature is a PNG."""
    return bool(feature["dtype"] == "image")


def schema_of(arrow: Any, features: dict[str, Feature]) -> Any:
    """Return the Arrow schema of the data files, with the types that `datasets` wants in its metadata.

    Args:
        arrow: the module pyarrow.
    """
    kinds = {
        "float32": arrow.float32(),
        "int64": arrow.int64(),
        "bool": arrow.bool_(),
        "uint16": arrow.uint16(),
    }
    columns: list[tuple[str, Any]] = []
    described: dict[str, dict[str, Any]] = {}
    for name, feature in features.items():
        shape = feature["shape"]
        if is_picture(feature):
            columns.append((name, arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())])))
            described[name] = {"_type": "Image"}
            continue
        kind, value = kinds[feature["dtype"]], {"dtype": feature["dtype"], "_type": "Value"}
        if shape == [1]:
            columns.append((name, kind))
            described[name] = value
        elif len(shape) == 1:
            columns.append((name, arrow.list_(kind, shape[0])))
            described[name] = {"feature": value, "length": shape[0], "_type": "List"}
        else:
            columns.append((name, arrow.list_(arrow.list_(kind))))
            described[name] = {"shape": shape, "dtype": feature["dtype"], "_type": "Array2D"}
    return arrow.schema(columns, metadata={"huggingface": json.dumps({"info": {"features": described}})})


def tasks_table(arrow: Any) -> Any:
    """Return `meta/tasks.parquet`: the number of each task, with its text as pandas' index, as LeRobot reads it."""
    text = "__index_level_0__"
    columns: list[dict[str, Any]] = [
        {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64", "metadata": None},
        {"name": None, "field_name": text, "pandas_type": "unicode", "numpy_type": "object", "metadata": None},
    ]
    pandas = {"index_columns": [text], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    table = arrow.table({"task_index": arrow.array([0], arrow.int64()), text: arrow.array([TASK])})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def info_of(features: dict[str, Feature], fps: int, episodes: int, frames: int) -> dict[str, Any]:
    """Return `meta/info.json`."""
    return {
        "codebase_version": CODEBASE_VERSION,
        "robot_type": ROBOT_TYPE,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": CHUNK_SIZE,
        "data_files_size_in_mb": FILE_SIZE,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA_PATH,
        "video_path": None,
        "features": features,
    }


def card(fps: int, features: Collection[str], uncatchable: int) -> str:
    """Return `README.md`: what a reader of the data set must know.

    Args:
        features: by name.
        uncatchable: how many of the games had rules without catching.
    """
    rows = [f"| {name} | {meaning} |" for name, feature, meaning in _MEANINGS if feature in features]
    catching = "All games had rules with catching: `next.success` says that the hider survived."
    if uncatchable:
        catching = (
            f"In {uncatchable} of the games catches were ignored (`vantage/catching` is false in `meta/episodes`): nothing could "
            "end them early, and `next.success` is false there, because surviving them was no success."
        )
    return f"""---
task_categories:
- robotics
tags:
- LeRobot
configs:
- config_name: default
  data_files: data/*/*.parquet
---

Games of visual hide-and-seek of two robots on a table, exported from Vantage's logs: one episode a game, one frame a step.
Games that were aborted, discarded or are incomplete in the log are not in it. {catching}

| feature | |
|---|---|
{chr(10).join(rows)}
| `observation.state` | the hider's x, y (m) and heading (rad, counter-clockwise from +x) in the arena |
| `action` | the hider's primitive of this step, one-hot: {", ".join(PRIMITIVES)}; one step is 10 mm or 10 degrees |
| `privileged.seeker_state`, `privileged.seeker_action` | the same of the seeker; the hider knows neither |
| `next.done`, `next.success` | the step is the game's last; and the hider survived |
| `timestamp`, `capture_time_ns` | capture of the hider's picture: s from the episode's first, and ns since the Unix epoch |

Timestamps are those of the cameras, not multiples of 1/fps; `fps` = {fps} is their median rate. `LeRobotDataset` (v3) takes them
as they are: it compares timestamps with fps only to decode videos, of which there are none, and finds the neighbours that
`delta_timestamps` asks for by their number of frames. `meta/episodes` says of each episode which game it was: number, seed,
outcome, whether there was catching, who drove, the layout. Depth is an array of numbers because what a loader makes of a 16-bit
PNG differs from version to version; it comes as integers.

LeRobot (0.4) gives a policy every picture, whatever its name, and all that begins with `observation` or `action`. What stands
below `privileged.` is what the hider cannot know: numbers and depth there are left alone, pictures have to be taken out of a
policy's input features by hand. `observation.depth.hider` counts as a state, which the usual policies expect to be one vector:
take it out, too, or use a policy of your own.

`info.json` knows one split. The one that Vantage's networks were trained with follows from a game's seed (`vantage/seed` in
`meta/episodes`) alone: `learning.splits.split_of(seed)` is 0 for training, 1 for validation, 2 for test.

```python
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset("vantage/hide-and-seek", root="this folder")
```
"""


def _picture(height: int, width: int) -> Feature:
    return {"dtype": "image", "shape": [height, width, 3], "names": ["height", "width", "channels"]}
