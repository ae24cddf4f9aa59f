"""`vantage evaluate maps`: value maps against ground truth (Table II), and how a hider fares that follows them."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markdown import Markdown
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from learning.methods.machine import Machine
from learning.methods.table import METHODS, load_methods
from learning.provenance import provenance
from learning.value_maps.judged import VALUES, maps_of, seconds_per_map
from learning.value_maps.page import page_of
from learning.value_maps.report import Maps, arrays, ground_truths, heuristic_maps, played, ranking
from learning.value_maps.truth import Case, cases_of, seeds_of_test_split
from schemas import Rules
from vantage.play import SeekerPreset

TIMED_MAPS = 5


@dataclass(frozen=True)
class EvaluateMapsSettings:
    """Value maps of each method beside ground truth from simulation, and survival of a hider that drives to the goal they choose.

    Example: vantage evaluate maps --weights weights/ --methods vpt-tob --starts 50 --to runs/maps
    """

    weights: Path = Path("weights")
    """Folder with the networks."""
    methods: tuple[str, ...] = ("vpt-tob",)
    """Which methods: rows of the method table."""
    starts: int = 50
    """Starts, each of a seed of the test split: a map each."""
    horizons: tuple[int, ...] = (200, 250, 300, 350)
    """T of the maps; the changes that are reported are from the first."""
    seeker: SeekerPreset = "glancing"
    """Preset of the seeker."""
    layout: str = "random"
    """`lab`, `random`, or the path of a layout file."""
    simulations: int = 20
    """Simulations of each goal, beside the one with the episode's own seed: the mean that is a second ground truth, and the score
    in play."""
    against: str = "vpt-tob"
    """The method with which the others are compared, start by start (the first one, where it is not among the methods)."""
    seed: int = 1
    """Draws the starts and the bootstrap."""
    to: Path = Path("runs/maps")
    """Write the results to this path, as .json, .md and .npz."""
    threads: int = 0
    """Threads, for simulation and networks; 0 = all cores."""


def main(settings: EvaluateMapsSettings) -> int:
    """Evaluate; returns the exit code."""
    if wrong := mistake_in(settings):
        print(wrong, file=sys.stderr)
        return 2
    methods, left_out = load_methods(settings.methods, settings.weights, Machine.fastest(settings.threads))
    for line in left_out:
        print(line, file=sys.stderr)
    if not methods:
        return 2
    names = [method.name for method in methods]
    against = settings.against if settings.against in names else names[0]
    rules = Rules(maximum_steps=max(settings.horizons), layout=settings.layout)
    seeds = seeds_of_test_split(settings.seed, settings.starts)
    horizons, cases = settings.horizons, list[Case]()
    maps: Maps = {}
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns) as progress:
        task = progress.add_task("true maps", total=len(seeds))
        for case in cases_of(seeds, rules, settings.seeker, settings.simulations, settings.threads):
            if len(case.goals):
                cases.append(case)
            progress.advance(task)
        if not cases:
            print("no start leaves the hider a goal it could drive to: take another layout", file=sys.stderr)
            return 2
        for method in methods:
            task = progress.add_task(method.name, total=len(cases))
            found = []
            for case in cases:
                found.append(maps_of(method, case, horizons))
                progress.advance(task)
            maps |= {f"{method.name}, {value}": np.stack([each[value] for each in found]) for value in VALUES}
    maps |= heuristic_maps(cases, horizons)
    report = {
        "provenance": provenance(),
        "left out": left_out,
        "weights": {method.name: {stem: card.sha256 for stem, card in method.cards.items()} for method in methods},
        "seed": settings.seed,
        "starts": [case.seed for case in cases],
        "seeker": settings.seeker,
        "layout": settings.layout,
        "simulations": settings.simulations,
        "horizons": list(horizons),
        "against": against,
        "goals per map": float(np.mean([len(case.goals) for case in cases])),
        "free goals per map": float(np.mean([case.free.sum() for case in cases])),
        "seeker seen at the start": float(np.mean([case.seeker is not None for case in cases])),
        "ground truths": list(ground_truths(cases, horizons)),
        "ranking": ranking(cases, horizons, maps, against, settings.seed),
        "ranking of free goals": ranking(cases, horizons, maps, against, settings.seed, free_only=True),
        "play": played(cases, horizons, maps, against, settings.seed),
        "seconds per map": {method.name: seconds_per_map(method, cases[:TIMED_MAPS], horizons[0]) for method in methods},
    }
    settings.to.parent.mkdir(parents=True, exist_ok=True)
    page = page_of(report)
    settings.to.with_suffix(".json").write_text(json.dumps(report, indent=2) + "\n")
    settings.to.with_suffix(".md").write_text(page)
    np.savez_compressed(settings.to.with_suffix(".npz"), **arrays(cases, horizons, maps))  # type: ignore[arg-type]
    Console().print(Markdown(page))
    print(f"results in {settings.to.with_suffix('.json')}, .md and .npz")
    return 0


def mistake_in(settings: EvaluateMapsSettings) -> str:
    """Return what is wrong with the settings; empty when nothing is."""
    if unknown := [name for name in settings.methods if name not in METHODS]:
        return f"there is no method {', '.join(unknown)}; the table has {', '.join(METHODS)}"
    if not settings.methods:
        return "--methods names no method"
    if settings.starts < 1:
        return "--starts must be at least 1"
    if settings.simulations < 2:
        return "--simulations must be at least 2: the best goal is chosen on one half and scored on the other"
    if not settings.horizons or min(settings.horizons) < 10:
        return "--horizons must name horizons of at least 10 steps, the interval of the checkpoints"
    return ""
