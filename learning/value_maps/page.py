"""The results as a page of Markdown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from learning.provenance import in_one_line

PAPER = {200: (75.29, 12.23), 250: (73.75, 10.35), 300: (73.03, 10.40), 350: (72.77, 10.82)}
"""Table II of the paper: T -> relative ranking accuracy and its standard deviation over maps, %."""

Cell = Callable[[dict[str, Any]], str]


def page_of(report: dict[str, Any]) -> str:
    """Return the results of `vantage evaluate maps` as a page."""
    horizons = [str(horizon) for horizon in report["horizons"]]
    first = horizons[0]
    one, mean = report["ground truths"]
    paper = ["the paper", *(_paper(int(horizon)) for horizon in horizons)]
    return "\n".join(
        [
            "# Value maps against ground truth, and the play they lead to",
            "",
            f"`{report['provenance']['command']}`",
            "",
            _setting(report),
            "",
            "## Relative ranking accuracy, equality included (the paper's Table II), %",
            "",
            f"Ground truth: {one}. Pairs of goals at least 3 cells apart; sign(Vi - Vj) must match. "
            f"{_tied(report, horizons, one)} of the pairs tie in the ground truth: what never ties (added probabilities, "
            "distances) is wrong about all of these.",
            "",
            *_table(report["ranking"], horizons, one, "with_ties", _percent, paper),
            "",
            "## The same over pairs that differ in the ground truth, %",
            "",
            f"Ground truth: {one}. A predicted tie is wrong.",
            "",
            *_table(report["ranking"], horizons, one, "without_ties", _percent),
            "",
            "The same, a predicted tie half right:",
            "",
            *_table(report["ranking"], horizons, one, "ties_half", _percent),
            "",
            "## Kendall's tau-b over these pairs",
            "",
            *_table(report["ranking"], horizons, one, "tau_b", _plain),
            "",
            f"## Against the {mean}, pairs that differ, %",
            "",
            *_table(report["ranking"], horizons, mean, "without_ties", _percent),
            "",
            f"## Change from T = {first}, equality included, points (paired by start)",
            "",
            *_table(report["ranking"], horizons[1:], one, "with_ties", _change),
            "",
            *[
                line
                for horizon in horizons
                for line in (f"## Play, T = {horizon}", "", *_played(report["play"][horizon], report), "")
            ],
            f"## Time of a whole map, T = {first}",
            "",
            "Median; on the machine above, with whatever else ran on it. The paper: 1.4 s on one GPU.",
            "",
            "| method | s |",
            "|---|---|",
            *(f"| {name} | {seconds:.2f} |" for name, seconds in report["seconds per map"].items()),
            "",
        ]
    )


def _setting(report: dict[str, Any]) -> str:
    return (
        f"{in_one_line(report['provenance'])}. {len(report['starts'])} starts of test seeds, drawn with seed {report['seed']}; "
        f"seeker `{report['seeker']}`, layout `{report['layout']}`; every goal simulated with the episode's own seed and "
        f"{report['simulations']} others; {report['goals per map']:.1f} goals a map, on {report['free goals per map']:.1f} of "
        "which the hider can truly stand. ± is the standard deviation over maps; brackets hold 95 % of the bootstrap over "
        "starts. Of a method trained with several seeds the figures are means over these, followed by standard deviation and "
        "range over seeds. `binary` adds v in {0, 1} as in the paper, `expected` adds probabilities, `rounded` rounds that sum. "
        "Methods learnt from plans of at most 200 steps and are asked about longer ones."
    )


def _table(
    found: dict[str, Any], horizons: Sequence[str], truth: str, measure: str, cell: Cell, *above: Sequence[str]
) -> list[str]:
    if not horizons:
        return ["(one horizon only)"]
    head = ["", *(f"T = {horizon}" for horizon in horizons)]
    rows = [[name, *(cell(found[horizon][truth][name][measure]) for horizon in horizons)] for name in found[horizons[0]][truth]]
    return _lines([head, *above, *rows])


def _played(found: dict[str, Any], report: dict[str, Any]) -> list[str]:
    head = [
        "goal chosen by",
        "steps survived",
        f"more than by {report['against']}, expected",
        "danger V",
        "caught by 100",
        "by 200",
        "by T",
    ]
    rows = [
        [
            name,
            _bracketed(fared["survival"], 1),
            _bracketed(fared["survival"].get("difference"), 1, signed=True),
            _bracketed(fared["V"], 2),
            *(_percent_alone(fared[f"caught by {step}"]) for step in ("100", "200", "T")),
        ]
        for name, fared in found.items()
    ]
    return _lines([head, *rows])


def _lines(rows: Sequence[Sequence[str]]) -> list[str]:
    head, *body = ("| " + " | ".join(row) + " |" for row in rows)
    return [head, "|" + "---|" * len(rows[0]), *body]


def _paper(horizon: int) -> str:
    return "{:.2f} ± {:.2f}".format(*PAPER[horizon]) if horizon in PAPER else ""


def _tied(report: dict[str, Any], horizons: Sequence[str], truth: str) -> str:
    any_name = next(iter(report["ranking"][horizons[0]][truth]))
    shares = [report["ranking"][horizon][truth][any_name]["tied"]["mean"] for horizon in horizons]
    return " / ".join("?" if share is None else f"{share:.0%}" for share in shares)


def _percent(found: dict[str, Any]) -> str:
    if found["mean"] is None:
        return ""
    spread = f" ± {100 * found['sd']:.2f}" if found["sd"] is not None else ""
    low, high = found["interval 95 %"]
    return f"{100 * found['mean']:.2f}{spread} [{100 * low:.1f}, {100 * high:.1f}]{_over_seeds(found, 100, 1)}"


def _over_seeds(found: dict[str, Any], scale: float, digits: int) -> str:
    """Return how far trainings with several seeds lie apart; nothing of a method that was trained once."""
    seeds = found.get("over seeds")
    if seeds is None:
        return ""
    low, high = seeds["range"]
    return f"; {seeds['n']} seeds ±{scale * seeds['sd']:.{digits}f} ({scale * low:.{digits}f}..{scale * high:.{digits}f})"


def _plain(found: dict[str, Any]) -> str:
    if found["mean"] is None:
        return ""
    return f"{found['mean']:.3f}" + (f" ± {found['sd']:.3f}" if found["sd"] is not None else "")


def _change(found: dict[str, Any]) -> str:
    change = found["change since the first horizon"]
    if change["mean"] is None:
        return ""
    low, high = change["interval 95 %"]
    return f"{100 * change['mean']:+.2f} [{100 * low:+.1f}, {100 * high:+.1f}]"


def _percent_alone(found: dict[str, Any]) -> str:
    return f"{100 * found['mean']:.1f} %"


def _bracketed(found: dict[str, Any] | None, digits: int, signed: bool = False) -> str:
    if found is None or found["mean"] is None:
        return ""
    form = f"{{:{'+' if signed else ''}.{digits}f}}"
    low, high = found["interval 95 %"]
    return f"{form.format(found['mean'])} [{form.format(low)}, {form.format(high)}]{_over_seeds(found, 1, digits)}"
