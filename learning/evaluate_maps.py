"""`vantage evaluate maps`: value maps against ground truth (Table II), and how a hider fares that follows them."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markdown import Markdown
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from learning.methods.machine import Machine
from learning.methods.table import METHODS, load_trainings
from learning.methods.trainings import weights_folder
from learning.provenance import provenance
from learning.value_maps.judged import VALUES, maps_of, seconds_per_map
from learning.value_maps.page import page_of
from learning.value_maps.report import Maps, arrays, ground_truths, heuristic_maps, played, ranking
from learning.value_maps.truth import Case, cases_of, seeds_of_test_split
from schemas import Rules
from services.planner.value_map import Value
from vantage.errors import UserError
from vantage.match import SeekerPreset
from vantage.output import complete, refuse_existing, write_complete

TIMED_MAPS = 5


class UnusableSettings(UserError, ValueError):
    """What was asked for cannot be evaluated."""


@dataclass(frozen=True)
class EvaluateMapsSettings:
    """Value maps of each method beside ground truth from simulation, and survival of a hider that drives to the goal they choose.

    Example: vantage evaluate maps --methods vpt-tob --starts 50
    """

    weights: Path | None = None
    """Folder with the networks; if not said, runs/ where a training has left some, else the released ones. A method trained with
    several seeds (NAME-seed1.safetensors, ...) is judged with each of them."""
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
    force: bool = False
    """Replace results that are there."""
    threads: int = 0
    """Threads, for simulation and networks; 0 = all cores."""


def main(settings: EvaluateMapsSettings) -> int:
    """Evaluate; returns the exit code."""
    check(settings)
    folder = weights_folder(settings.weights)
    methods, left_out = load_trainings(settings.methods, folder, Machine.fastest(settings.threads))
    for line in left_out:
        print(line, file=sys.stderr)
    if not methods:
        raise UnusableSettings(f"no method has its weights in {folder}: choose another --weights")
    table, text, maps_file = (settings.to.with_name(settings.to.name + ending) for ending in (".json", ".md", ".npz"))
    refuse_existing(table, text, maps_file, force=settings.force)
    if settings.weights is None:
        print(f"weights in {folder}", file=sys.stderr)
    against = settings.against if settings.against in methods else next(iter(methods))
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
            raise UnusableSettings("no start leaves the hider a goal it could drive to: take another layout")
        for name, trained in methods.items():
            task = progress.add_task(name, total=len(cases) * len(trained))
            found: list[list[dict[Value, NDArray[np.float64]]]] = []  # [seeds][starts]
            for method in trained:
                found.append([])
                for case in cases:
                    found[-1].append(maps_of(method, case, horizons))
                    progress.advance(task)
            for value in VALUES:
                by_seed = np.stack([[each[value] for each in starts] for starts in found])
                maps[f"{name}, {value}"] = by_seed if len(trained) > 1 else by_seed[0]
    maps |= heuristic_maps(cases, horizons)
    report = {
        "provenance": provenance(),
        "left out": left_out,
        "weights": {
            name: {stem: card.sha256 for method in trained for stem, card in method.cards.items()}
            for name, trained in methods.items()
        },
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
        "seconds per map": {
            name: seconds_per_map(trained[0], cases[:TIMED_MAPS], horizons[0]) for name, trained in methods.items()
        },
    }
    page = page_of(report)
    write_complete(table, json.dumps(report, indent=2) + "\n")
    write_complete(text, page)
    with complete(maps_file) as partial:
        np.savez_compressed(partial, **arrays(cases, horizons, maps))  # type: ignore[arg-type]
    Console().print(Markdown(page))
    print(f"results in {table}, {text} and {maps_file}")
    return 0


def check(settings: EvaluateMapsSettings) -> None:
    """Raise UnusableSettings with what people can do about it."""
    if unknown := [name for name in settings.methods if name not in METHODS]:
        raise UnusableSettings(f"there is no method {', '.join(unknown)}; the table has {', '.join(METHODS)}")
    if not settings.methods:
        raise UnusableSettings("--methods names no method")
    if settings.starts < 1:
        raise UnusableSettings("--starts must be at least 1")
    if settings.simulations < 2:
        raise UnusableSettings("--simulations must be at least 2: the best goal is chosen on one half and scored on the other")
    if not settings.horizons or min(settings.horizons) < 10:
        raise UnusableSettings("--horizons must name horizons of at least 10 steps, the interval of the checkpoints")
