"""`vantage figures`: every figure of the results page, from a training set, weights and results."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure

from learning.dataset import DEFAULT_DATASET, Dataset
from learning.figures import charts, games, maps
from learning.figures.style import METHODS, save
from learning.methods.machine import Machine
from learning.methods.table import load_methods
from learning.methods.trainings import weights_folder
from learning.methods.views import PredictedViews
from learning.provenance import provenance
from vantage.cores import available_cores
from vantage.output import AlreadyExists, remove_abandoned, write_complete
from vantage.printable import printable


@dataclass(frozen=True)
class FiguresSettings:
    """Draw the paper's figures: training pair, predicted and true views, methods side by side, value maps, a run, charts.

    Example: vantage figures
    """

    data: Path = DEFAULT_DATASET
    """The training set; pictures show its test games."""
    weights: Path | None = None
    """Folder with the networks; if not said, runs/ where a training has left some, else the released ones. What is not there is
    not drawn."""
    results: Path = Path("runs")
    """Folder with accuracy.json, maps.json and maps.npz, as `vantage evaluate` and `vantage evaluate maps` leave them."""
    to: Path = Path("figures")
    """Folder for the pictures."""
    force: bool = False
    """Draw figures anew that are there already."""
    threads: int = 0
    """CPU threads; 0 = all cores."""


CAPTIONS = {
    "training-pairs": "What VPT-TOB is shown (the hider's view, F and T of its plan) and what it is to predict.",
    "predicted-views": "The seeker's views along two test games, predicted at step 0, beside the true ones. The games are "
    "chosen by rule: the first that is caught between two and four fifths of T, and the first that survives.",
    "side-by-side": "The same game through every method: predicted views, and the risk over time.",
    "value-maps": "True and predicted value maps of the first starts: danger from blue (low) to red (high).",
    "run": "A run: the value map of VPT-TOB, the goal chosen, and how the game went.",
    "table-1": "Accuracy of every method, with the paper's.",
    "accuracy-over-horizon": "Accuracy by horizon.",
    "reliability": "How often those were caught to whom a risk was told.",
    "table-2": "Relative ranking accuracy from 200 to 350 steps, with the paper's.",
    "play": "How long a hider stays free that drives to the goal each method chooses.",
}


def main(settings: FiguresSettings) -> int:
    """Draw; returns the exit code."""
    data, accuracy, ranking = (
        Dataset(settings.data),
        read(settings.results / "accuracy.json"),
        read(settings.results / "maps.json"),
    )
    torch.set_num_threads(settings.threads or available_cores())
    settings = replace(settings, weights=weights_folder(settings.weights))
    assert settings.weights is not None
    methods, left_out = load_methods(METHODS, settings.weights, Machine.fastest(settings.threads))
    for line in left_out:
        print(printable(line), file=sys.stderr)
    view_methods = {method.name: method for method in methods if isinstance(method, PredictedViews)}
    chosen = games.chosen_games(data)
    drawn: dict[str, Callable[[], Figure]] = {"training-pairs": lambda: games.training_pairs(data)}
    if "vpt-tob" in view_methods:
        drawn["predicted-views"] = lambda: games.predicted_views(data, view_methods["vpt-tob"], chosen)
        drawn["run"] = lambda: _run(settings, data, ranking)
    if methods:
        drawn["side-by-side"] = lambda: games.side_by_side(data, methods, chosen[0])
    if accuracy:
        drawn["table-1"] = lambda: charts.table_one(accuracy)
        drawn["accuracy-over-horizon"] = lambda: charts.over_horizon(accuracy)
        drawn["reliability"] = lambda: charts.reliability(accuracy)
    if ranking:
        if (arrays := settings.results / "maps.npz").is_file():
            drawn["value-maps"] = lambda: maps.value_maps(maps.read_maps(arrays), ranking["layout"])
        drawn["table-2"] = lambda: charts.table_two(ranking)
        drawn["play"] = lambda: charts.play_chart(ranking)
    written = {name: settings.to / f"{name}.png" for name in CAPTIONS if name in drawn}
    summary = settings.to / "figures.json"
    for path in (*written.values(), summary):
        if path.exists() and not settings.force:
            raise AlreadyExists(path, "choose another --to, or draw anew with --force")
    remove_abandoned(settings.to)
    summary.unlink(missing_ok=True)  # it comes last: it is about all figures
    for name, path in written.items():
        save(drawn[name](), path)
        print(printable(str(path)), flush=True)
    left = [name for name in CAPTIONS if name not in drawn]
    if left:
        print(f"not drawn, as results or weights for them are missing: {', '.join(left)}", file=sys.stderr)
    pictures = {f"{name}.png": caption for name, caption in CAPTIONS.items() if name in drawn}
    report = {"provenance": provenance(), "data": data.hash, "games in the data": len(data.episodes), "figures": pictures}
    write_complete(summary, json.dumps(report, indent=2) + "\n")
    return 0


def read(path: Path) -> dict[str, Any]:
    """Return the results in a file; empty where there are none."""
    return json.loads(path.read_text()) if path.is_file() else {}


def _run(settings: FiguresSettings, data: Dataset, ranking: dict[str, Any]) -> Figure:
    """A run from the first start of the value maps; without them, from that of the first test game."""
    from learning.figures.run import play_run, run

    if ranking:
        layout, seeker, seed, steps = ranking["layout"], ranking["seeker"], ranking["starts"][0], ranking["horizons"][0]
    else:
        row = int(data.of_split("test")[0])
        episode = data.episodes[row]
        layout, seeker = data.name_of(row, "layout"), data.name_of(row, "seeker")
        seed, steps = int(episode["seed"]), int(episode["horizon"])
    assert settings.weights is not None
    return run(play_run(settings.weights, layout, seeker, seed, steps, settings.threads))
