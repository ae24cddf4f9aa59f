"""How the results of a reproduction were made: its commands, cards and data in one file beside them, `results/made.json`.

The results page needs nothing else than `results/`, so that it can be written again from what is published.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from learning.reproduce.presets import RELEASED

Json = dict[str, Any]


def read(path: Path) -> Json:
    """Return a file's JSON; empty where there is none."""
    return json.loads(path.read_text()) if path.is_file() else {}


def made_of(folder: Path) -> Json:
    """Return how the results in a reproduction's folder were made; read from `results/made.json` where that is all there is.

    Keys: `minutes on the clock`; `stages` (by name: `command`, `seconds`, `commit`, `hardware`, `taken_from`, `resumed`);
    `weights` (model cards by group and file stem); `data` (by kind: `episodes`, `hiders`, `megabytes`, `hash`, `command`);
    `released bytes`.
    """
    stamps = {path.stem: read(path) for path in sorted((folder / "stamps").glob("*.json"))}
    if not stamps:
        return read(folder / "results/made.json")
    stages = {
        name: {
            "command": stamp["command"],
            "seconds": stamp["seconds"],
            "commit": stamp["provenance"].get("commit", ""),
            "hardware": stamp["provenance"].get("hardware", {}),
            "taken_from": stamp.get("taken_from", ""),
            "resumed": stamp.get("resumed", False),
        }
        for name, stamp in sorted(stamps.items(), key=lambda item: item[1]["began"])
        if name != "page"
    }
    groups = sorted(path for path in (folder / "weights").glob("*") if path.is_dir())
    released = sorted((folder / "weights" / RELEASED.name).glob("*.safetensors"))
    return {
        "minutes on the clock": wall([(stamp["began"], stamp["seconds"]) for stamp in stamps.values()]) / 60,
        "stages": stages,
        "weights": {group.name: {path.stem: read(path) for path in sorted(group.glob("*.json"))} for group in groups},
        "data": {path.name: found for path in sorted((folder / "data").glob("*")) if (found := _data(path))},
        "released bytes": sum(path.stat().st_size for path in released),
    }


def wall(spans: list[tuple[float, float]]) -> float:
    """Return the seconds in which at least one of some stages ran, each given as when it began and for how long it ran."""
    total = end = 0.0
    for began, seconds in sorted(spans):
        total += max(0.0, began + seconds - max(end, began))
        end = max(end, began + seconds)
    return total


def _data(folder: Path) -> Json:
    dataset = read(folder / "dataset/manifest.json")
    if not dataset:
        return {}
    return {
        "episodes": dataset["episodes"],
        "hiders": dataset["hiders"],
        "megabytes": round(sum(path.stat().st_size for path in (folder / "dataset").iterdir()) / 1e6),
        "hash": dataset["hash"],
        "command": read(folder / "manifest.json").get("command", ""),
    }


def seed_of(card: Json) -> str:
    """Return the seed that a model card names; empty where it names none."""
    seed = card.get("training", {}).get("seed")
    return "" if seed is None else str(seed)
