"""The results page's section on what a hider can know: every method beside the ceiling of its view."""

from __future__ import annotations

from learning.accuracy.report import CLOCK, ORACLE, VIEW_ORACLE
from learning.figures.charts import headline, known
from learning.figures.style import title_of
from learning.reproduce import tables
from learning.reproduce.made import Json
from learning.reproduce.tables import Findings, markdown, percent


def what_can_be_known(found: Findings) -> list[str]:
    """Return the section: all methods at t0 = 0, in order of their accuracy; empty where the ceiling was not measured."""
    limit = headline(found.accuracy)["horizon limit"]
    asked = tables.set_of(found.accuracy, "first", limit)
    if asked is None or VIEW_ORACLE not in asked["methods"]:
        return []
    lines = [
        f"### What can be known from the hider's view (t0 = 0, T = {limit})",
        "",
        f"The *{ORACLE}* knows the whole arena; a hider has seen one view. The *{VIEW_ORACLE}* plays each game on in arenas "
        "drawn from all that look exactly the same to the hider: boxes that it sees stay where they are, boxes that it does not "
        "see are drawn anew from the distribution of the layout `random`; the seeker's pose follows from the view at the start, "
        "where the two face each other. Up to its number of simulations it is the ceiling of every method that is shown this "
        f"view and this plan. The oracles judged the first {asked['methods'][VIEW_ORACLE]['examples']:,} examples.",
        "",
    ]
    rows = [_row(f"**{name}**", asked["methods"][name]) for name in (VIEW_ORACLE, ORACLE) if name in asked["methods"]]
    rows.append(_row(CLOCK, asked["methods"][CLOCK]))
    for group, report in {found.compared: found.accuracy, **found.of_groups}.items():
        if set_ := tables.set_of(report, "first", limit):
            rows += [
                _row(f"{title_of(name)}, `{group}`{' †' if found.caveat(group, name) else ''}", set_["methods"][name])
                for name in known(set_["methods"])
            ]
    rows.sort(key=lambda row: row[0])
    head = ["", "accuracy, % [95 %]", "balanced, %", "AUROC", "over horizon only, points"]
    return [*lines, *markdown(head, [cells for _, cells in rows]), ""]


def _row(title: str, one: Json) -> tuple[float, list[str]]:
    area = "" if one["AUROC"] is None else f"{one['AUROC']:.3f}"
    return one["accuracy"], [title, tables.accuracy_of(one), percent(one["balanced accuracy"]), area, tables.over(one, CLOCK)]
