"""`vantage log verify`: is a log whole and true? Rules recomputed from the poses, services replayed from their inputs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from learning.process_replay import replay_service, replayable, why_silent
from schemas import GOAL_COUNT, ROBOTS
from vantage.log import find_logs, open_log
from vantage.log.episodes import EpisodeLog, games_of
from vantage.world.arena import CATCH_TOLERANCE


@dataclass(frozen=True)
class VerifySettings:
    """Check a recorded log: is it whole, are the outcomes true, do the services say the same again?

    Every game of a simulated table is played again from its seed, its rules and the logged commands, also a human's. Ends with
    exit code 0 only if everything holds.

    Example: vantage log verify demo/table-20260101-120000.mcap
    """

    log: Annotated[Path, tyro.conf.Positional]
    """The log: a file, or the first part of a split one."""


@dataclass(frozen=True)
class Finding:
    """One thing that was checked; `good` is None where there is nothing that could be right or wrong."""

    what: str
    good: bool | None
    detail: str


def check_game(game: EpisodeLog) -> list[Finding]:
    """Return what holds of one game, judged from its messages alone."""
    name = f"game {game.number}"
    drove = f"hider: {game.episode.players.hider}{', discarded' * game.discarded}"
    if game.episode.phase != "ended":
        good = None if game.discarded else False
        return [Finding(f"{name} ended", good, f"{game.episode.phase}: {game.episode.reason}")]
    findings = [Finding(f"{name} is whole", game.whole, f"{game.steps} steps, {game.lost} messages lost, {drove}")]
    for robot in ROBOTS:
        expected = {step for step in range(game.steps) if robot not in game.late.get(step, ())}
        missing = expected - game.commands[robot].keys()
        findings.append(Finding(f"{name}: one {robot} command a step", not missing, f"{len(game.commands[robot])} commands"))
    outcome, caught_step = recomputed_outcome(game)
    same = (outcome, caught_step) == (game.episode.outcome, game.episode.caught_step)
    findings.append(
        Finding(
            f"{name}: outcome recomputed from the poses", same, outcome if caught_step is None else f"{outcome} at {caught_step}"
        )
    )
    for step, plan in game.plans.items():
        if plan.values:
            blocked = sum(value is None for value in plan.values)
            good = len(plan.values) == GOAL_COUNT and plan.goal is not None and plan.values[plan.goal] is not None
            findings.append(
                Finding(f"{name}: value map of step {step}", good, f"{GOAL_COUNT} goals, {blocked} blocked, goal {plan.goal}")
            )
    return findings


def recomputed_outcome(game: EpisodeLog) -> tuple[str, int | None]:
    """Return outcome and step of the catch as the poses and the rules have it."""
    rules = game.episode.rules
    for step in range(1, game.steps + 1):
        if any(step not in game.poses[robot] for robot in ROBOTS):
            continue  # the game is not whole, which is found elsewhere
        hider, seeker = game.poses["hider"][step], game.poses["seeker"][step]
        if rules.catching and math.hypot(hider.x - seeker.x, hider.y - seeker.y) <= rules.catch_distance + CATCH_TOLERANCE:
            return "caught", step
    return ("survived" if game.steps >= rules.maximum_steps else "undecided"), None


def main(settings: VerifySettings) -> int:
    """Print what holds; 0 if all does."""
    findings = []
    for parts in find_logs(settings.log):
        with open_log(*parts) as log:
            findings += [finding for game in games_of(log) for finding in check_game(game)]
    if not findings:
        findings.append(Finding("a game", False, "the log holds none"))
    for service in replayable():
        comparisons = replay_service(settings.log, service)
        if not comparisons:
            findings.append(Finding(f"replay: {service}", None, why_silent(settings.log, service)))
        for comparison in comparisons:
            detail = "; ".join(comparison.differences) or f"{comparison.compared} messages, all the same"
            findings.append(Finding(f"replay: {comparison.key} by {service}", not comparison.differences, detail))
    table = Table("", "checked", "found")
    for finding in findings:
        table.add_row({True: "ok", False: "[red]NO[/red]", None: "-"}[finding.good], finding.what, finding.detail)
    Console(highlight=False).print(table)
    return 1 if any(finding.good is False for finding in findings) else 0
