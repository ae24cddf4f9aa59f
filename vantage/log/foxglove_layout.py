"""A ready layout for Foxglove and Lichtblick, made from the viewer topics that are there.

Written in the form that both import: panels by id, and a binary tree that says where they are.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from schemas import ROBOTS
from vantage.log.appearance import Appearance
from vantage.log.metadata import VIEWER_PREFIX
from vantage.log.viewer import ARENA_FRAME

SUFFIX = ".layout.json"
_FARTHEST = 1500  # mm that the depth panels tell apart; the arena's diagonal is 1.7 m

Tree = str | dict[str, Any]


def layout_of(topics: Collection[str], looks: Appearance) -> dict[str, Any]:
    """Return a layout: the scene, pictures, value map, predicted views, texts and plots, as far as there are topics for them.

    Args:
        topics: full names (`viewer/...`).
        looks: the arena's size, which the scene's camera looks at, and the robots' colours.
    """
    size = looks.arena_size
    there = {topic.removeprefix(VIEWER_PREFIX) for topic in topics if topic.startswith(VIEWER_PREFIX)}
    panels: dict[str, dict[str, Any]] = {}
    panels["3D!scene"] = _scene(there, looks)
    rows: list[Tree] = []
    for robot in ROBOTS:
        row: list[Tree] = []
        for part, title in (("color", "colour"), ("depth", "depth"), ("view", "state image")):
            if f"{robot}/{part}" in there:
                row.append(_add_image(panels, f"{robot}/{part}", f"{robot}: {title}", f"{robot}/calibration" in there))
        if row:
            rows.append(_chain(row, "row"))
    insight = [
        _add_image(panels, topic, title)
        for topic, title in (
            ("hider/plan/picture", "value map: danger of each goal, from blue (low) to red (high); the black frame is the goal"),
            ("predictor/views", "seeker views that the hider predicts"),
        )
        if topic in there
    ]
    if insight:
        rows.append(_chain(insight, "row"))
    below: list[Tree] = []
    if "text" in there:
        panels["RosOut!text"] = {
            **_titled("what was said"),
            "topicToRender": f"{VIEWER_PREFIX}text",
            "minLogLevel": 2,
            "searchTerms": [],
        }
        below.append("RosOut!text")
    for coordinate in ("x", "y"):
        paths = [
            {
                "value": f"{VIEWER_PREFIX}{robot}/pose.pose.position.{coordinate}",
                "enabled": True,
                "timestampMethod": "receiveTime",
                "label": f"{robot} {coordinate}, m",
                "color": _hexadecimal(looks.robot_colors[robot]),
            }
            for robot in ROBOTS
            if f"{robot}/pose" in there
        ]
        if paths:
            panel = f"Plot!{coordinate}"
            panels[panel] = {
                **_titled(f"{coordinate} of the robots, m"),
                "paths": paths,
                "minYValue": 0,
                "maxYValue": size,
                "showLegend": True,
                "legendDisplay": "floating",
                "showPlotValuesInLegend": True,
                "showXAxisLabels": True,
                "showYAxisLabels": True,
                "isSynced": True,
                "xAxisVal": "timestamp",
                "sidebarDimension": 240,
            }
            below.append(panel)
    upper = _split("3D!scene", _chain(rows, "column"), "row", 45) if rows else "3D!scene"
    tree = _split(upper, _chain(below, "row"), "column", 75) if below else upper
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": tree,
    }


def as_json(layout: Mapping[str, Any]) -> str:
    """Return the text of a layout file."""
    return json.dumps(layout, indent=1) + "\n"


def _hexadecimal(color: Iterable[int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)


def _scene(there: Collection[str], looks: Appearance) -> dict[str, Any]:
    size = looks.arena_size
    topics: dict[str, Any] = {
        f"{VIEWER_PREFIX}{topic}": {"visible": True} for topic in ("scene", "hider/plan/path") if topic in there
    }
    if "hider/plan/values" in there:
        topics[f"{VIEWER_PREFIX}hider/plan/values"] = {
            "visible": True,
            "colorField": "danger",
            "colorMode": "gradient",
            "gradient": [_hexadecimal(color) + "80" for color in (looks.danger[0], looks.danger[-1])],
        }
    for robot in ROBOTS:
        if f"{robot}/calibration" in there:
            topics[f"{VIEWER_PREFIX}{robot}/calibration"] = {"visible": True, "distance": 0.15, "planarProjectionFactor": 0}
    return {
        **_titled("the arena"),
        "cameraState": {
            "perspective": True,
            "distance": 1.7 * size,
            "phi": 35,
            "thetaOffset": 0,
            "targetOffset": [size / 2, size / 2, 0],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.01,
            "far": 100,
        },
        "followMode": "follow-none",
        "followTf": ARENA_FRAME,
        "scene": {"enableStats": False, "transforms": {"showLabel": False, "axisScale": 0.05}},
        "transforms": {},
        "topics": topics,
        "layers": {},
        "imageMode": {},
    }


def _add_image(panels: dict[str, dict[str, Any]], topic: str, title: str, calibrated: bool = False) -> str:
    mode: dict[str, Any] = {"imageTopic": VIEWER_PREFIX + topic}
    robot, _, part = topic.partition("/")
    if calibrated and part in ("color", "depth"):
        mode["calibrationTopic"] = f"{VIEWER_PREFIX}{robot}/calibration"
    if part == "depth":
        mode |= {"colorMode": "colormap", "colorMap": "turbo", "minValue": 0, "maxValue": _FARTHEST}
    panel = f"Image!{topic.replace('/', '-')}"
    panels[panel] = {**_titled(title), "imageMode": mode, "topics": {}, "layers": {}, "transforms": {}, "scene": {}}
    return panel


def _titled(title: str) -> dict[str, str]:
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}


def _split(first: Tree, second: Tree, direction: str, percentage: float) -> Tree:
    return {"first": first, "second": second, "direction": direction, "splitPercentage": percentage}


def _chain(parts: Sequence[Tree], direction: str) -> Tree:
    """Return a tree of equal parts one after the other."""
    if len(parts) == 1:
        return parts[0]
    return _split(parts[0], _chain(parts[1:], direction), direction, 100 / len(parts))
