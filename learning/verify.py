"""`vantage log verify`: is a log whole and true? Rules recomputed from the poses, services replayed from their inputs."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from learning.process_replay import contents_of, replay_services, replayable, why_silent
from schemas import GOAL_COUNT, ROBOTS
from services.referee.reasons import is_on_request
from vantage.log import find_logs, open_log
from vantage.log.episodes import EpisodeLog, games_of
from vantage.log.reader import Log, Record
from vantage.printable import counted
from vantage.world.arena import CATCH_TOLERANCE, goal_name

RECORDED_NOW = "it is being recorded now: check it again when it is finished"
CUT_SHORT = "it was cut short: `vantage log recover` makes it whole"


@dataclass(frozen=True)
class VerifySettings:
    """Check a recorded log: is it whole, are the outcomes true, do the services say the same again?

    Every game of a simulated table is played again from its seed, its rules and the logged commands, also a human's. Ends with
    exit code 0 only if everything holds.

    Example: vantage log verify demo/table-20260101-120000.mcap
    """

    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
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
        good = None if game.discarded or is_on_request(game.episode.reason) else False
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
            chosen = "no goal" if plan.goal is None else goal_name(plan.goal)
            findings.append(
                Finding(f"{name}: value map of step {step}", good, f"{GOAL_COUNT} goals, {blocked} blocked, {chosen}")
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


class WatchedLog(Log):
    """A log that tells how far it has been read."""

    def watch(self, told: Callable[[float], None]) -> Self:
        """Call `told` with the part that has been read, 0..1, from now on."""
        self._told = told
        return self

    def records(self, topics: Collection[str] | None = None, viewer: bool = False, after: int = -1) -> Iterator[Record]:
        """Yield the messages; see `Log.records`."""
        chunks = [chunk for file in self.files for chunk in file.chunks if chunk.end]
        start = min((chunk.start for chunk in chunks), default=0)
        duration = max(max((chunk.end for chunk in chunks), default=0) - start, 1)
        for record in super().records(topics, viewer, after):
            self._told((record.log_time - start) / duration)
            yield record


def check_whole(log: Log, told: Callable[[float], None]) -> list[Finding]:
    """Return whether every byte of a log reads, also those that no check of its games needs."""
    findings = []
    total, done = max(sum(chunk.length for file in log.files for chunk in file.chunks), 1), 0
    for file in log.files:
        for chunk in file.chunks:
            file.messages_of(chunk)
            done += chunk.length
            told(done / total)
        findings += [Finding(f"{file.path.name} reads", False, text) for text in file.breaks]
        if not file.finished:
            findings.append(Finding(f"{file.path.name} was closed", False, RECORDED_NOW if file.recording else CUT_SHORT))
        log.release(file)
    return findings or [Finding("the log is whole", True, counted(len(log.files), "file"))]


def check(path: Path, told: Callable[[str, float], None] = lambda what, part: None) -> list[Finding]:
    """Return all that holds of a log, or of the logs in a folder.

    Args:
        told: what is under way, and how much of it is done, 0..1.

    Raises:
        FileNotFoundError: there is no log.
    """
    logs = find_logs(path)
    whole: list[Finding] = []
    games: list[Finding] = []

    def say(what: str, place: int) -> Callable[[float], None]:
        return lambda part: told(what, (place + part) / len(logs))

    for place, parts in enumerate(logs):
        with WatchedLog(open_log(*parts).files).watch(say("reading the games", place)) as log:
            whole += check_whole(log, say("reading every byte", place))
            games += [finding for game in games_of(log) for finding in check_game(game)]
    findings = [*whole, *(games or [Finding("a game", False, "the log holds none")])]

    def records() -> Iterator[Record]:
        for place, parts in enumerate(logs):
            with WatchedLog(open_log(*parts).files).watch(say("replaying the services", place)) as log:
                yield from log.records()

    contents = contents_of(path)
    for service, comparisons in replay_services(contents, records(), replayable()).items():
        if not comparisons:
            findings.append(Finding(f"replay: {service}", None, why_silent(contents, service)))
        for comparison in comparisons:
            detail = "; ".join(comparison.differences) or f"{comparison.compared} messages, all the same"
            findings.append(Finding(f"replay: {comparison.key} by {service}", not comparison.differences, detail))
    return findings


def main(settings: VerifySettings) -> int:
    """Print what holds; 0 if all does."""
    console = Console(highlight=False)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %"))
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=1.0)
        findings = check(settings.log, lambda what, part: progress.update(bar, description=what, completed=part))
    table = Table("", "checked", "found")
    for finding in findings:
        sign = {True: "ok", False: "[red]NO[/red]", None: "-"}[finding.good]
        table.add_row(sign, escape(finding.what), escape(finding.detail))
    console.print(table)
    return 1 if any(finding.good is False for finding in findings) else 0
