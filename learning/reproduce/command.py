"""`vantage reproduce`: the whole study from nothing, in stages that are not repeated once they are done."""

from __future__ import annotations

import json
import shlex
import shutil
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from learning.methods.trainings import RELEASED as RELEASED_WEIGHTS
from learning.reproduce.page import PAGES
from learning.reproduce.presets import PRESETS, RELEASED
from learning.reproduce.runner import Progress, Runner, minutes, tail
from learning.reproduce.stages import Machine, stages_of
from vantage.errors import UserError
from vantage.output import complete, write_complete

TOLD_EVERY = 60.0  # s between lines where the output is no terminal


@dataclass(frozen=True)
class ReproduceSettings:
    """Redo the paper's simulation study from nothing: data, networks, baselines, Tables I and II, figures, results page.

    Stages that are done are kept, so the same command goes on where it was interrupted.

    Examples:
      vantage reproduce --preset quick
      vantage reproduce --preset hours --have reproduction/quick --publish
      vantage reproduce --preset hours --given longer=weights/ --list
    """

    preset: Literal["quick", "hours", "paper", "smoke"] = "quick"
    """`quick`: half an hour on two CPU cores. `hours`: two hours on two cores. `paper`: the paper's scale, for a GPU.
    `smoke`: a minute; shows that everything runs, and its figures mean nothing."""
    to: Path | None = None
    """Folder for everything; default reproduction/PRESET."""
    have: tuple[Path, ...] = ()
    """Folders of earlier reproductions: what the very same commands made there from the same data is taken over."""
    given: tuple[str, ...] = ()
    """GROUP=FOLDER: networks of a group that lie trained in a folder, with their cards, and are taken as they are."""
    publish: bool = False
    """Also copy page, figures and results into docs/."""
    workers: int = 0
    """Trainings at a time; 0 = one for each core, or one on a GPU."""
    list: bool = False
    """Only print the commands."""


def main(settings: ReproduceSettings) -> int:
    """Reproduce; returns the exit code."""
    folder = settings.to or Path("reproduction") / settings.preset
    preset, machine = PRESETS[settings.preset], Machine.here()
    stages = stages_of(settings.preset, preset, machine, given_weights(settings, folder))
    display = Display(Console(highlight=False))
    runner = Runner(stages, folder, settings.workers or (1 if machine.gpu else machine.cores), settings.have, display.show)
    if settings.list:
        for stage in stages:
            print(shlex.join(("vantage", *runner.arguments(stage))))
        return 0
    where = "one GPU" if machine.gpu else f"{machine.cores} cores"
    display.console.print(f"reproduction `{settings.preset}` in {folder}/: {len(stages)} stages on {where}")
    with display:
        whole = runner.run()
    states = Counter(runner.progress.state.values())
    if not whole:
        failed = ", ".join(name for name, state in runner.progress.state.items() if state == "failed")
        raise StagesFailed(
            f"failed: {failed}; {states['blocked']} could not begin. The logs are in {folder}/logs/; mend what they say, then "
            "the same command goes on: what is done is kept"
        )
    kept = f"{states['kept']} stages were done before, " if states["kept"] else ""
    elapsed = minutes(time.monotonic() - runner.progress.began)
    display.console.print(f"{kept}{states['done'] + states['taken']} made now, in {elapsed}. The page: {folder / 'results.md'}")
    if settings.publish:
        publish(folder, Path())
        display.console.print("published: docs/results.md, docs/figures/, docs/results/")
    return 0


class StagesFailed(UserError):
    """Some stages failed; the text names them."""


class Refusal(UserError, ValueError):
    """A reproduction that cannot be made so; the text says why."""


def given_weights(settings: ReproduceSettings, folder: Path) -> list[Path]:
    """Copy what was given, and the released weights, into the reproduction's weights; return where it lies there.

    Raises:
        Refusal: a group or a file is not there.
    """
    groups = {group.name for group in PRESETS[settings.preset].groups}
    places = []
    released = (f"{RELEASED.name}={RELEASED_WEIGHTS}",) if RELEASED.name in groups else ()
    for gift in (*released, *settings.given):
        group, _, source = gift.partition("=")
        if group not in groups:
            raise Refusal(f"--given {gift}: the preset `{settings.preset}` has the groups {', '.join(sorted(groups))}")
        found = sorted(Path(source).glob("*.safetensors"))
        if not found:
            raise Refusal(f"--given {gift}: no weights in {source}")
        target = folder / "weights" / group
        places += [target / path.name for path in found]
        if settings.list:
            continue
        target.mkdir(parents=True, exist_ok=True)
        for path in (other for weights in found for other in (weights, weights.with_suffix(".json"), weights.with_suffix(".md"))):
            if path.resolve() != (target / path.name).resolve():
                shutil.copy2(path, target / path.name)
    return places


def publish(folder: Path, root: Path) -> None:
    """Copy page, figures and results of a reproduction into docs/ of a checkout, in place of those that are there."""
    docs = root / "docs"
    for part, endings in (("figures", ("*.png", "*.json")), ("results", ("*.json", "*.md"))):
        with complete(docs / part) as target:
            target.mkdir()
            for path in sorted(path for ending in endings for path in (folder / part).glob(ending)):
                if path.suffix == ".json":  # without indentation a third of the size
                    (target / path.name).write_text(json.dumps(json.loads(path.read_text()), separators=(",", ":")) + "\n")
                else:
                    shutil.copy2(path, target / path.name)
    for page in PAGES:
        write_complete(docs / page, (folder / page).read_bytes())


class Display:
    """Tells how it goes: a picture that renews itself on a terminal, else a line now and then."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._live = Live(console=console, refresh_per_second=2, transient=True) if console.is_terminal else None
        self._told = time.monotonic()

    def __enter__(self) -> Display:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._live.stop()

    def show(self, progress: Progress, event: str) -> None:
        """Show the state; `event` is a line to keep, or empty."""
        if event:
            self.console.print(f"[{_clock(time.monotonic() - progress.began)}] {event}", markup=False, soft_wrap=True)
        if self._live:
            self._live.update(Group(*(Text(line, no_wrap=True, overflow="ellipsis") for line in lines_of(progress))))
        elif not event and time.monotonic() - self._told > TOLD_EVERY:
            self._told = time.monotonic()
            self.console.print("\n".join(lines_of(progress)), markup=False, soft_wrap=True)


def lines_of(progress: Progress) -> list[str]:
    """Return how a reproduction stands, in a line, and a line for each process that runs."""
    elapsed = _clock(time.monotonic() - progress.began)
    head = f"[{elapsed}] {progress.finished} of {len(progress.stages)} stages done, about {minutes(progress.left())} left"
    number = {stage.name: index + 1 for index, stage in enumerate(progress.stages)}
    return [
        head,
        *(
            f"   stage {number[running.stage.name]}, {running.stage.name}, {minutes(time.monotonic() - running.began)}: "
            + "".join(tail(running.log, 1)).strip()
            for running in progress.running
        ),
    ]


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 3600}:{int(seconds) // 60 % 60:02d}:{int(seconds) % 60:02d}"
