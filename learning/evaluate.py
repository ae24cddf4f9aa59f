"""`vantage evaluate`: how well VPN judges what VPT-TOB predicts, beside what needs no network."""

from __future__ import annotations

import json
import os
import shlex
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from learning.dataset import Dataset, Samples
from learning.measures import accuracy, area_under_roc, balanced_accuracy, best_clock, bootstrap_interval
from learning.train_vpn import predict_views
from vantage.log import source_commit
from vantage.networks.vpn import Vpn
from vantage.networks.vpt_tob import VptTob
from vantage.networks.weights import fast_device, load


@dataclass(frozen=True)
class EvaluateSettings:
    """Accuracy of VPN on VPT-TOB's predictions, on unseen test examples: t0 = 0 (see --any-start), horizon uniform.

    Example: vantage evaluate --data dataset/ --weights weights/ --samples 1000
    """

    data: Path = Path("dataset")
    """The training set; only its test episodes are looked at (and, for the clock, the catches of its training episodes)."""
    weights: Path = Path("weights")
    """Folder with vpt-tob.safetensors and vpn.safetensors."""
    samples: int = 1000
    """Examples for each horizon."""
    horizons: tuple[int, ...] = (100, 200)
    """T: examples have horizons below each of these."""
    any_start: bool = False
    """Let any step before the catch be t0 in half of the examples, not only the first of an episode."""
    to: Path | None = Path("runs/evaluation")
    """Write the results to this path, as .json and .md."""
    threads: int = 0
    """CPU threads; 0 = all cores."""
    seed: int = 1


def judge(vpt_tob: VptTob, vpn: Vpn, data: Dataset, samples: Samples, device: torch.device) -> NDArray[np.float32]:
    """Return VPN's logits of "caught" [B] for VPT-TOB's predictions."""
    with torch.inference_mode():
        return torch.cat([vpn(views.float()).cpu() for views in predict_views(vpt_tob, data, samples, device)]).numpy()


def measure(scores: NDArray[np.float32], data: Dataset, samples: Samples, limit: int, seed: int) -> dict[str, Any]:
    """Return what is to be said of one set of examples, network and simple predictors alike."""
    truth, predicted = samples.caught, scores > 0
    clock = best_clock(data.episodes["caught_step"][data.of_split("train")], limit)
    by_clock = samples.horizon >= clock
    low, high = bootstrap_interval(predicted, truth, samples.episode, seed)
    clock_low, clock_high = bootstrap_interval(by_clock, truth, samples.episode, seed)
    hiders = data.episodes["hider"][samples.episode]
    edges = np.linspace(0, limit, 6).astype(int)
    bins = [(int(low_edge), int(high_edge)) for low_edge, high_edge in pairwise(edges)]
    where = {f"{a}..{b - 1}": (samples.horizon >= a) & (samples.horizon < b) for a, b in bins}
    return {
        "horizon limit": limit,
        "examples": len(samples),
        "caught share": float(truth.mean()),
        "accuracy": accuracy(predicted, truth),
        "accuracy interval 95 %": [low, high],
        "balanced accuracy": balanced_accuracy(predicted, truth),
        "AUROC": area_under_roc(scores, truth),
        "majority class": float(max(truth.mean(), 1 - truth.mean())),
        "horizon only": accuracy(by_clock, truth),
        "horizon only interval 95 %": [clock_low, clock_high],
        "horizon only balanced": balanced_accuracy(by_clock, truth),
        "horizon only AUROC": area_under_roc(samples.horizon, truth),
        "horizon only says caught from step": clock,
        "by hider": {
            name.decode(): {"examples": int(mine.sum()), **_pair(predicted, by_clock, truth, mine)}
            for name in np.unique(hiders)
            for mine in [hiders == name]
        },
        "by horizon": {
            name: {"examples": int(mine.sum()), **_pair(predicted, by_clock, truth, mine)}
            for name, mine in where.items()
            if mine.any()
        },
    }


def _pair(
    predicted: NDArray[np.bool_], by_clock: NDArray[np.bool_], truth: NDArray[np.bool_], mine: NDArray[np.bool_]
) -> dict[str, float]:
    return {
        "caught share": float(truth[mine].mean()),
        "accuracy": accuracy(predicted[mine], truth[mine]),
        "horizon only": accuracy(by_clock[mine], truth[mine]),
    }


def main(settings: EvaluateSettings) -> int:
    """Evaluate; returns the exit code."""
    torch.set_num_threads(settings.threads or os.cpu_count() or 1)
    device, data = fast_device(), Dataset(settings.data)
    vpt_tob, vpt_tob_card = load(settings.weights / "vpt-tob.safetensors", VptTob)
    vpn, vpn_card = load(settings.weights / "vpn.safetensors", Vpn)
    vpt_tob, vpn = vpt_tob.to(device, memory_format=torch.channels_last), vpn.to(device)  # type: ignore[call-overload]
    results = []
    for limit in settings.horizons:
        generator = np.random.default_rng([settings.seed, limit])
        from_start = 0.5 if settings.any_start else 1.0
        samples = data.draw("test", settings.samples, generator, from_start, horizon_limit=limit, symmetries=1)
        results.append(measure(judge(vpt_tob, vpn, data, samples, device), data, samples, limit, settings.seed))
    report = {
        "command": shlex.join(["vantage", "evaluate", *sys.argv[2:]]),
        "commit": source_commit(),
        "seed": settings.seed,
        "data": data.hash,
        "seekers": data.manifest["seekers"],
        "test episodes": len(data.of_split("test")),
        "weights": {"vpt-tob": vpt_tob_card.sha256, "vpn": vpn_card.sha256},
        "vpn learnt from these vpt-tob weights": vpt_tob_card.sha256 in vpn_card.inputs.values(),
        "trained on this data": data.hash == vpt_tob_card.data.get("hash") == vpn_card.data.get("hash"),
        "results": results,
    }
    Console().print(table_of(results))
    for warning in ("vpn learnt from these vpt-tob weights", "trained on this data"):
        if not report[warning]:
            print(f"warning: not {warning}", file=sys.stderr)
    if settings.to:
        settings.to.parent.mkdir(parents=True, exist_ok=True)
        settings.to.with_suffix(".json").write_text(json.dumps(report, indent=2) + "\n")
        settings.to.with_suffix(".md").write_text(markdown_of(report))
        print(f"results in {settings.to.with_suffix('.json')} and .md")
    return 0


def _rows(result: dict[str, Any]) -> list[tuple[str, ...]]:
    low, high = result["accuracy interval 95 %"]
    clock_low, clock_high = result["horizon only interval 95 %"]
    name = f"T = {result['horizon limit']}"
    return [
        (
            f"{name}: VPN on VPT-TOB",
            f"{result['accuracy']:.1%} [{low:.1%}, {high:.1%}]",
            f"{result['balanced accuracy']:.1%}",
            f"{result['AUROC']:.3f}",
        ),
        (
            f"{name}: horizon only (caught from step {result['horizon only says caught from step']} on)",
            f"{result['horizon only']:.1%} [{clock_low:.1%}, {clock_high:.1%}]",
            f"{result['horizon only balanced']:.1%}",
            f"{result['horizon only AUROC']:.3f}",
        ),
        (f"{name}: majority class", f"{result['majority class']:.1%}", "50.0%", "0.500"),
        *(
            (
                f"{name}, {kind} {key} ({part['examples']})",
                f"{part['accuracy']:.1%} (horizon only {part['horizon only']:.1%})",
                "",
                "",
            )
            for kind, table in (("hider", result["by hider"]), ("horizon", result["by horizon"]))
            for key, part in table.items()
        ),
    ]


_COLUMNS = ("", "accuracy [95 % interval]", "balanced", "AUROC")


def table_of(results: list[dict[str, Any]]) -> Table:
    """Return the results for the terminal."""
    table = Table(*_COLUMNS, title="is the hider caught? unseen test examples")
    for result in results:
        for row in _rows(result):
            table.add_row(*row)
        table.add_section()
    return table


def markdown_of(report: dict[str, Any]) -> str:
    """Return the results as a page."""
    lines = [
        "# Is the hider caught? VPN on VPT-TOB predictions, unseen test examples",
        "",
        f"`{report['command']}`, commit `{report['commit']}`, seed {report['seed']}, data `{report['data'][:16]}`,",
        f"{report['test episodes']} test episodes, seekers {report['seekers']}",
        "",
        "| " + " | ".join(_COLUMNS) + " |",
        "|" + "---|" * len(_COLUMNS),
    ]
    for result in report["results"]:
        lines += ["| " + " | ".join(row) + " |" for row in _rows(result)]
    return "\n".join(lines) + "\n"
