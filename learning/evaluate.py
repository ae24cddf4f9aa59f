"""`vantage evaluate`: how often each method is right about unseen games, all on the same examples (paper, Table I)."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from learning.accuracy.examples import STARTS, Start, blind_logits, draw_examples, frequency_logits
from learning.accuracy.page import fewer, page_of, table_of
from learning.accuracy.report import CLOCK, MAJORITY, ORACLE, VIEW_ORACLE, judged, without_nan
from learning.dataset import DEFAULT_DATASET, Dataset, Samples
from learning.methods.machine import Machine
from learning.methods.method import Method
from learning.methods.table import ABLATIONS, METHODS, load_trainings
from learning.methods.trainings import weights_folder
from learning.methods.views import judge_true_views
from learning.provenance import provenance
from vantage.errors import UserError
from vantage.networks.vpn import Vpn
from vantage.networks.weights import ModelCard, load
from vantage.output import refuse_existing, write_complete


@dataclass(frozen=True)
class EvaluateSettings:
    """Accuracy of methods on unseen test examples, all on the same ones, with t0 any step before the catch and with t0 = 0.

    Example: vantage evaluate --samples 1000 10000 --horizons 100 200 --oracle 50
    """

    data: Path = DEFAULT_DATASET
    """The training set; its test episodes are judged, its training episodes tell what the horizon alone is worth."""
    weights: Path | None = None
    """Folder with the weights; if not said, runs/ where a training has left some, else the released ones. Methods whose weights
    are not there are left out. A method trained with several seeds (NAME-seed1.safetensors, ...) is judged with each of them."""
    methods: tuple[str, ...] = tuple(name for name in METHODS if name not in ABLATIONS)
    """Which methods: rows of the method table."""
    samples: tuple[int, ...] = (1000,)
    """Examples of each set; a smaller set is the beginning of a larger one (the paper: 1,000)."""
    horizons: tuple[int, ...] = (100, 200)
    """T: examples have horizons below each of these."""
    starts: tuple[Start, ...] = STARTS
    """`uniform`: t0 is any step before the catch, as in the paper. `first`: t0 = 0, as the planner asks."""
    oracle: int = 0
    """Simulations of the Monte Carlo oracles: one knows the true state and policies, the other (t0 = 0, layout `random`) only
    what the hider's view tells of the arena: the ceilings. 0 = none."""
    oracle_samples: int = 1000
    """The oracles judge the first so many examples of each set."""
    ablations: bool = False
    """Also VPN on true views, and the VPN that learnt from true views (vpn-on-true.safetensors) on predictions."""
    to: Path | None = Path("runs/accuracy")
    """Write the results to this path, as .json and .md."""
    force: bool = False
    """Replace results that are there."""
    threads: int = 0
    """CPU threads; 0 = all cores."""
    seed: int = 1
    """Draws the examples and the bootstrap."""


class UnusableSettings(UserError, ValueError):
    """What was asked for cannot be evaluated."""


def main(settings: EvaluateSettings) -> int:
    """Evaluate; returns the exit code."""
    check(settings)
    data, machine, console = Dataset(settings.data), Machine.fastest(settings.threads), Console(stderr=True)
    wanted = dict.fromkeys((*settings.methods, *(ABLATIONS if settings.ablations else ())))
    folder = weights_folder(settings.weights)
    methods, left_out = load_trainings((name for name in METHODS if name in wanted), folder, machine)
    for line in left_out:
        print(line, file=sys.stderr)
    if not methods:
        raise UnusableSettings(f"no method has its weights in {folder}: choose another --weights")
    files = [settings.to.with_name(settings.to.name + ending) for ending in (".json", ".md")] if settings.to else []
    refuse_existing(*files, force=settings.force)
    if settings.weights is None:
        print(f"weights in {folder}", file=sys.stderr)
    warnings = warnings_of([method for trained in methods.values() for method in trained], data)
    results: list[dict[str, Any]] = []
    for start in settings.starts:
        for limit in settings.horizons:
            examples = draw_examples(data, "test", max(settings.samples), start, limit, settings.seed)
            logits, clock_step = blind(data, examples, start, limit, settings.seed)
            logits |= judge_all(methods, data, examples, console)
            if settings.ablations:
                logits |= on_true_views(folder, data, examples, machine)
            if settings.oracle:
                asked = examples.part(0, min(settings.oracle_samples, len(examples)))
                try:
                    logits[ORACLE] = consult_oracle(data, asked, settings.oracle, settings.threads, console)
                    if start == "first" and set(data.manifest["layouts"]) == {"random"}:
                        logits[VIEW_ORACLE] = consult_view_oracle(data, asked, settings.oracle, settings.threads, console)
                except ValueError as error:
                    warnings += [line for line in [f"no oracle: {error}"] if line not in warnings]
            for count in settings.samples:
                part = {name: found[:count] for name, found in logits.items()}
                results.append(result_of(part, data, examples.part(0, count), start, limit, clock_step, settings.seed))
    report = without_nan(report_of(settings, data, methods, left_out, warnings, results))
    papers = {name: row.paper for name, row in METHODS.items()}
    out = Console() if sys.stdout.isatty() else Console(width=100)
    for result in report["results"]:
        out.print(table_of(result, papers), *fewer(result), "", sep="\n")
    for line in warnings:
        print(f"warning: {line}", file=sys.stderr)
    if files:
        table, page = files
        write_complete(table, json.dumps(report, indent=2, allow_nan=False) + "\n")
        write_complete(page, page_of(report))
        print(f"results in {table} and {page}")
    return 0


def check(settings: EvaluateSettings) -> None:
    """Raise UnusableSettings with what people can do about it."""
    if unknown := [name for name in settings.methods if name not in METHODS]:
        raise UnusableSettings(f"there is no method {', '.join(unknown)}; the table has {', '.join(METHODS)}")
    for name in ("methods", "samples", "horizons", "starts"):
        if not getattr(settings, name):
            raise UnusableSettings(f"--{name} names nothing")
    for name in ("samples", "horizons"):
        if min(getattr(settings, name)) < 1:
            raise UnusableSettings(f"--{name} must be at least 1")
    if settings.oracle < 0 or settings.oracle_samples < 1:
        raise UnusableSettings("--oracle must be at least 0 and --oracle-samples at least 1")


def blind(data: Dataset, examples: Samples, start: Start, limit: int, seed: int) -> tuple[dict[str, NDArray[np.float32]], int]:
    """Return the logits [B] of the predictors that look at nothing, and the step from which on the clock says "caught"."""
    constant, clock, step = blind_logits(data, examples, start, limit, seed)
    return {MAJORITY: constant, CLOCK: clock}, step


def judge_all(
    methods: dict[str, list[Method]], data: Dataset, examples: Samples, console: Console
) -> dict[str, NDArray[np.float32]]:
    """Return the logits of every method, by name: [B], or [seeds, B] of one that was trained with several seeds."""
    questions, found = data.questions(examples), {}
    with _progress(console) as progress:
        task = progress.add_task("methods", total=sum(map(len, methods.values())))
        for name, trained in methods.items():
            progress.update(task, description=name)
            answers = []
            for method in trained:
                answers.append(method.judge(questions))
                progress.advance(task)
            found[name] = answers[0] if len(answers) == 1 else np.stack(answers)
    return found


def consult_oracle(data: Dataset, examples: Samples, simulations: int, threads: int, console: Console) -> NDArray[np.float32]:
    """Return the oracle's logits [B]: how many of the games that go on from the true state at t0 end in a catch by the horizon.

    Raises:
        ValueError: some of the games cannot be played again.
    """
    from learning.roll_outs import oracle_catch_steps

    with _progress(console) as progress:
        task = progress.add_task(ORACLE, total=len(examples))
        caught = oracle_catch_steps(data, examples, simulations, threads, lambda done: progress.advance(task, done))
    return _share_caught(caught, examples, simulations)


def consult_view_oracle(
    data: Dataset, examples: Samples, simulations: int, threads: int, console: Console
) -> NDArray[np.float32]:
    """Return the logits [B] of how many games end in a catch by the horizon that begin with the hider's view, in arenas drawn
    from all that look the same.

    Raises:
        ValueError: some of the games cannot be played so.
    """
    from learning.roll_outs import imagined_catch_steps

    with _progress(console) as progress:
        task = progress.add_task(VIEW_ORACLE, total=len(examples))
        caught, same = imagined_catch_steps(data, examples, simulations, threads, lambda done: progress.advance(task, done))
    if same:
        console.print(f"{VIEW_ORACLE}: no other arena found in {100 * same:.1f} % of the simulations, the true one was taken")
    return _share_caught(caught, examples, simulations)


def _share_caught(caught: NDArray[np.int32], examples: Samples, simulations: int) -> NDArray[np.float32]:
    by_horizon = (caught >= 0) & (caught <= (examples.start + examples.horizon)[:, None])  # [B, simulations]
    return frequency_logits(by_horizon.mean(axis=1), simulations)


def on_true_views(weights: Path, data: Dataset, examples: Samples, machine: Machine) -> dict[str, NDArray[np.float32]]:
    """Return the logits [B] of each VPN in the folder on the views that the seeker really had."""
    found = {}
    for stem in ("vpn", "vpn-on-true"):
        path = weights / f"{stem}.safetensors"
        if path.exists():
            found[f"true views, {stem}"] = judge_true_views(load(path, Vpn)[0], data, examples, machine)
    return found


def warnings_of(methods: list[Method], data: Dataset) -> list[str]:
    """Return a line on everything that makes the comparison less than fair."""
    lines = []
    for file, card in {file: card for method in methods for file, card in method.cards.items()}.items():
        if card.data.get("hash") != data.hash:
            lines.append(f"{file} was trained on other data than --data (splits go by seed, alike in every gathered set)")
    for method in methods:
        files = list(method.cards)
        if (
            len(files) == 2
            and not files[1].startswith("vpn-on-true")
            and method.cards[files[0]].sha256 not in method.cards[files[1]].inputs.values()
        ):
            lines.append(f"{method.name}: {files[1]} did not learn from what these {files[0]} weights predict")
    samples: dict[str, Any] = {}
    for method in methods:
        samples.setdefault(method.name, seen(next(iter(method.cards.values())))["samples"])
    if len(set(samples.values())) > 1:
        lines.append("the networks saw different numbers of samples: " + ", ".join(f"{k} {v:,}" for k, v in samples.items() if v))
    return lines


def seen(card: ModelCard) -> dict[str, Any]:
    """Return what a network learnt from and how much of it: `sha256`, `preset`, `seed`, `commit`, `data` (hash), `samples` (None
    for a VPN), `images` (None for others)."""
    return {
        "sha256": card.sha256,
        "preset": card.preset,
        "seed": card.training.get("seed"),
        "commit": card.commit,
        "data": str(card.data.get("hash", "")),
        "samples": card.training.get("samples"),
        "images": card.training.get("images"),
    }


def result_of(
    logits: dict[str, NDArray[np.float32]], data: Dataset, examples: Samples, start: Start, limit: int, clock_step: int, seed: int
) -> dict[str, Any]:
    """Return one set of examples with every method on it."""
    return {
        "start": start,
        "horizon limit": limit,
        "examples": len(examples),
        "episodes": len(np.unique(examples.episode)),
        "caught share": float(examples.caught.mean()),
        "horizon only says caught from step": clock_step,
        "methods": judged(logits, data, examples, seed),
    }


def report_of(
    settings: EvaluateSettings,
    data: Dataset,
    methods: dict[str, list[Method]],
    left_out: list[str],
    warnings: list[str],
    results: list[dict[str, Any]],
) -> dict[str, Any]:
    """Return everything that goes into the JSON."""
    kept = ("hash", "seekers", "layouts", "hiders", "horizons")
    return {
        "provenance": provenance(),
        "seed": settings.seed,
        "data": {**{key: data.manifest[key] for key in kept}, "test episodes": len(data.of_split("test"))},
        "oracle simulations": settings.oracle,
        "methods": {
            name: {
                "description": METHODS[name].description,
                "paper": METHODS[name].paper,
                "weights": {file: seen(card) for method in trained for file, card in method.cards.items()},
            }
            for name, trained in methods.items()
        },
        "left out": left_out,
        "warnings": warnings,
        "results": results,
    }


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description:<18}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
