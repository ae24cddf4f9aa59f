"""The results as tables: for the terminal, and as a page of Markdown with the paper's figures beside ours."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE
from rich.table import Table

from learning.accuracy.report import CLOCK, ORACLE, VIEW_ORACLE
from learning.provenance import in_one_line

PAPER_LIMIT = 200
"""The paper's Table I is about games of 200 steps."""
_STARTS = {"uniform": "t0 any step before the catch", "first": "t0 = 0"}
_HEADS = ("", "accuracy", "95 %", "balanced", "AUROC", "over clock", "paper")


def title_of(result: dict[str, Any]) -> str:
    """Return what a set of examples is, in one line."""
    start = _STARTS[result["start"]]
    return f"T = {result['horizon limit']}, {start}: {result['examples']:,} examples of {result['episodes']:,} games"


def table_of(result: dict[str, Any], papers: dict[str, float | None]) -> Table:
    """Return a set's results for the terminal, %, 80 columns wide."""
    table = Table(title=title_of(result), title_justify="left", box=SIMPLE, padding=0, pad_edge=False, show_edge=False)
    heads = _HEADS if result["horizon limit"] == PAPER_LIMIT else _HEADS[:-1]
    seeded = any("over seeds" in found for found in result["methods"].values())
    for number, head in enumerate((*heads, "seeds") if seeded else heads):
        table.add_column(head, justify="left" if number == 0 else "right", no_wrap=True)
    for name, found in result["methods"].items():
        row = (name, *_row(name, found, result, papers))[: len(heads)]
        table.add_row(*row, *([over_seeds(found.get("over seeds"))] if seeded else []))
    return table


def over_seeds(found: dict[str, Any] | None) -> str:
    """Return how far the trainings with several seeds lie apart, points: standard deviation, range, how many."""
    return "" if found is None else f"±{100 * found['sd']:.1f} ({_interval(found['range'])}, n = {found['n']})"


def _row(name: str, found: dict[str, Any], result: dict[str, Any], papers: dict[str, float | None]) -> tuple[str, ...]:
    paper = papers.get(name) if result["horizon limit"] == PAPER_LIMIT else None
    gain = found["against"].get(CLOCK)
    return (
        _percent(found["accuracy"]),
        _interval(found["accuracy interval 95 %"]),
        _percent(found["balanced accuracy"]),
        _number(found["AUROC"], 3),
        "" if gain is None else f"{100 * gain['difference']:+.1f} ({_interval(gain['interval 95 %'])})",
        "" if paper is None else f"{100 * paper:.2f}",
    )


def page_of(report: dict[str, Any]) -> str:
    """Return the results of `vantage evaluate` as a page."""
    data, methods = report["data"], report["methods"]
    papers = {name: found["paper"] for name, found in methods.items()}
    lines = [
        "# Is the hider caught? Accuracy on unseen test games",
        "",
        f"`{report['provenance']['command']}`",
        "",
        f"Data `{data['hash'][:16]}`: {data['test episodes']} test games, seekers {', '.join(data['seekers'])};",
        f"seed {report['seed']}; {in_one_line(report['provenance'])}.",
        "",
        "All figures in %, but for AUROC and log loss. Intervals: 95 %, whole games drawn again (examples of one game share its",
        f"catch). *{CLOCK}* is the best predictor that knows nothing but how far ahead it is asked, fitted on training games;",
        f"*over clock* is the paired difference to it. *{ORACLE}* plays the game on from its true state with the true policies;",
        f"*{VIEW_ORACLE}* plays it in arenas drawn from all that look the same to the hider at the start.",
        "Of a method trained with several seeds all figures are means over these, and *over seeds* says how far the trainings'",
        "accuracies lie apart: standard deviation (range), beside the interval over games. A method without it was trained once.",
        "The paper's figures are from its Table I (its own game and seeker).",
        "",
        *(f"* {line}" for line in (*report["warnings"], *report["left out"])),
        "",
    ]
    for result in report["results"]:
        lines += [f"## {title_of(result)}", "", *_main_table(result, papers), "", *fewer(result)]
        lines += [f"### By horizon, {title_of(result)}", "", *_parts_table(result, "by horizon"), ""]
        lines += [f"### By hider, {title_of(result)}", "", *_parts_table(result, "by hider"), ""]
    lines += ["## Weights", "", *_markdown(_WEIGHT_HEADS, _weight_rows(methods))]
    return "\n".join(lines) + "\n"


def fewer(result: dict[str, Any]) -> list[str]:
    """Return a line on each method that judged only the first of the examples."""
    counts = {name: found["examples"] for name, found in result["methods"].items()}
    return [f"{name}: the first {count:,} examples only\n" for name, count in counts.items() if count < result["examples"]]


def _main_table(result: dict[str, Any], papers: dict[str, float | None]) -> list[str]:
    heads: tuple[str, ...] = (
        "",
        "accuracy",
        "95 %",
        "balanced",
        "AUROC",
        "over clock",
        "over vpt-tob",
        "ECE",
        "Brier",
        "log loss",
    )
    heads += ("over seeds", "paper")
    rows = []
    for name, found in result["methods"].items():
        *measures, paper = _row(name, found, result, papers)
        over, told = found["against"].get("vpt-tob"), found["calibration"]
        rows.append(
            (
                name,
                *measures,
                "" if over is None else f"{100 * over['difference']:+.1f} ({_interval(over['interval 95 %'])})",
                _percent(told["expected calibration error"]),
                _percent(told["Brier"]),
                _number(told["log loss"], 3),
                over_seeds(found.get("over seeds")),
                paper,
            )
        )
    return _markdown(heads, rows)


def _parts_table(result: dict[str, Any], kind: str) -> list[str]:
    methods = result["methods"]
    parts = next(iter(methods.values()))[kind]
    rows = [
        (
            text,
            str(part["examples"]),
            _percent(part["caught share"]),
            *(_percent(found[kind][text]["accuracy"]) if text in found[kind] else "" for found in methods.values()),
        )
        for text, part in parts.items()
    ]
    return _markdown((kind.removeprefix("by "), "examples", "caught", *methods), rows)


_WEIGHT_HEADS = ("method", "file", "preset", "seed", "samples seen", "images", "training set", "sha256")


def _weight_rows(methods: dict[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            name,
            file,
            str(weights["preset"]),
            "" if weights.get("seed") is None else str(weights["seed"]),
            "" if weights["samples"] is None else f"{weights['samples']:,}",
            "" if weights["images"] is None else f"{weights['images']:,}",
            f"`{weights['data'][:8]}`",
            f"`{weights['sha256'][:8]}`",
        )
        for name, found in methods.items()
        for file, weights in found["weights"].items()
    ]


def _markdown(heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    ruler = "|" + "---|" * len(heads)
    return ["| " + " | ".join(heads) + " |", ruler, *("| " + " | ".join(row) + " |" for row in rows)]


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.1f}"


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _interval(interval: list[float]) -> str:
    low, high = interval
    return f"{100 * low:.1f}..{100 * high:.1f}"
