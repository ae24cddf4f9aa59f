"""The `vantage` command: a table of commands, each imported only when it is asked for."""

from __future__ import annotations

import importlib
import importlib.metadata
import inspect
import io
import os
import select
import sys
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from vantage.errors import explain
from vantage.printable import printable
from vantage.stopping import follow_parent, run_stoppable


@dataclass(frozen=True, slots=True)
class Command:
    """One row of the command table.

    Attributes:
        words: what people type after `vantage`.
        target: `module:function`; the function takes one settings dataclass, whose fields become options, and returns an exit
            code or None.
        summary: one line for `vantage --help`.
        kept: what is kept when the command is stopped by Ctrl-C, and how to go on; the end of one line.
    """

    words: str
    target: str
    summary: str
    kept: str = ""


_LOGS = "finished logs are kept; the same command goes on"
_NOTHING = "nothing was written; run it again"
_CHECKPOINT = "the same command goes on from the last checkpoint"
_FIGURES = "finished figures are kept; run it again with --force for all"
_STAGES = "finished stages are kept; the same command goes on"
_MEASURED = "what was measured before stays in force; run it again"
_ENDING = "its services are ending; `vantage status` shows it"
_FILES = "finished files are kept; run it again for the others"

COMMANDS = (
    Command("demo", "learning.demo:main", "play one game with trained weights, record it and draw it", _ENDING),
    Command("up", "vantage.commands:up", "start a deployment and wait until every service is healthy", _ENDING),
    Command("status", "vantage.commands:status", "how each service does: state, restarts, memory, stale inputs"),
    Command("logs", "vantage.commands:logs", "what a service printed"),
    Command("down", "vantage.commands:down", "stop a deployment", _ENDING),
    Command("check", "vantage.commands:check", "look at deployments without starting them"),
    Command("play", "vantage.play:main", "play games on a running deployment"),
    Command("stop", "vantage.play:stop", "end the games of a running deployment"),
    Command("replay", "vantage.replay.command:main", "play a recorded log on the bus, for the console and any service"),
    Command(
        "gather",
        "learning.gather:main",
        "make one whole training set: games, conversion, exact split sizes",
        _LOGS,
    ),
    Command(
        "collect",
        "learning.collect:main",
        "simulate games in parallel into MCAP logs",
        _LOGS,
    ),
    Command("convert", "learning.convert:main", "turn logs into a training set", _NOTHING),
    Command(
        "train vpt-tob",
        "learning.train_vpt_tob:main",
        "train a network that predicts a view: VPT-TOB and its baselines",
        _CHECKPOINT,
    ),
    Command(
        "train vpn",
        "learning.train_vpn:main",
        "train the network that judges a predicted view",
        _CHECKPOINT,
    ),
    Command(
        "train caught",
        "learning.train_caught:main",
        'train a network that says "caught" itself: hazard, coordinate-value',
        _CHECKPOINT,
    ),
    Command(
        "evaluate",
        "learning.evaluate:main",
        "accuracy of trained weights beside what needs no network",
        _NOTHING,
    ),
    Command(
        "evaluate maps",
        "learning.evaluate_maps:main",
        "value maps against ground truth, and the play they lead to",
        _NOTHING,
    ),
    Command(
        "figures",
        "learning.figures.command:main",
        "draw the figures of the paper from data, weights and results",
        _FIGURES,
    ),
    Command(
        "reproduce",
        "learning.reproduce.command:main",
        "redo the whole study from nothing, and write its results page",
        _STAGES,
    ),
    Command("reproduce page", "learning.reproduce.page:main", "write the results page of a reproduction"),
    Command("log info", "vantage.log_commands:info", "what is in a log"),
    Command(
        "log recover",
        "vantage.log_commands:recover",
        "repair a log that was cut off",
        _FILES,
    ),
    Command("log verify", "learning.verify:main", "check that a log is whole, its outcomes true, its services repeatable"),
    Command(
        "log export",
        "vantage.log_commands:export",
        "write a log for Foxglove, Rerun or LeRobot, or as a video",
        _NOTHING,
    ),
    Command("foxglove", "vantage.live_viewer:main", "show a running deployment in Foxglove or Lichtblick"),
    Command(
        "table print", "vantage.table_commands:print_sheets", "PDFs at true scale for a real table: tags, board, ruler", _FILES
    ),
    Command("table calibrate lens", "vantage.table_commands:calibrate_lens", "measure the overhead camera's lens", _MEASURED),
    Command("table calibrate arena", "vantage.table_commands:calibrate_arena", "find where the overhead camera hangs", _MEASURED),
    Command(
        "table calibrate robot",
        "vantage.table_commands:calibrate_robot",
        "write down a robot's RGB-D camera and its mount",
        _MEASURED,
    ),
    Command("table colors", "vantage.table_commands:colors", "measure the robots' colours under your lamps", _MEASURED),
    Command("table check", "vantage.table_commands:check", "look at a real table before a game"),
)

FIRST_STEPS = """examples:
  vantage demo                              see it work
  vantage up simulation                     start all services
  vantage play --seed 7 --games 3           play three games on them
  vantage status                            how they do
  vantage down                              stop them
  vantage collect --help                    the options of a command"""


def overview() -> str:
    """Return the text of `vantage --help`."""
    width = max(len(command.words) for command in COMMANDS) + 2
    rows = "\n".join(f"  {command.words:<{width}}{command.summary}" for command in COMMANDS)
    purpose = "Two robots play hide-and-seek; one sees through the other's eyes."
    return f"usage: vantage COMMAND [options]\n\n{purpose}\n\ncommands:\n{rows}\n\n{FIRST_STEPS}"


def find(arguments: Sequence[str]) -> tuple[Command, Sequence[str]] | None:
    """Return the command that the arguments begin with, and the rest of them; None when they name no command."""
    for length in (3, 2, 1):
        words = " ".join(arguments[:length])
        for command in COMMANDS:
            if len(arguments) >= length and command.words == words:
                return command, arguments[length:]
    return None


def parse(command: Command, arguments: Sequence[str]) -> tuple[Callable[[Any], int | None], Any]:
    """Return the command's function and the settings that the arguments are parsed into.

    Raises:
        SystemExit: they are refused, or ask for help.
    """
    import tyro

    function, kind = settings_of(command)
    return function, tyro.cli(kind, args=list(arguments), prog=f"vantage {command.words}", description=inspect.getdoc(kind))


def settings_of(command: Command) -> tuple[Callable[[Any], int | None], type]:
    """Return the command's function and the dataclass whose fields are its options."""
    module, _, name = command.target.partition(":")
    function = getattr(importlib.import_module(module), name)
    (parameter,) = inspect.signature(function).parameters
    return function, typing.get_type_hints(function)[parameter]


def run(command: Command, arguments: Sequence[str]) -> int:
    """Parse the arguments into the command's settings and run it. Returns the exit code."""
    function, settings = parse(command, arguments)
    return int(function(settings) or 0)


def main() -> None:
    """Entry point of the `vantage` script."""
    if "VANTAGE_STAGE" in os.environ:  # a stage of `vantage reproduce`
        follow_parent()
    arguments = sys.argv[1:]
    if arguments == ["--version"]:
        print(f"vantage {importlib.metadata.version('vantage-hide-and-seek')}")
        sys.exit(0)
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(overview())
        sys.exit(0)
    found = find(arguments)
    if found is None:
        group = [command for command in COMMANDS if command.words.startswith(arguments[0] + " ")]
        if group:
            asked = len(arguments) > 1 and arguments[1] in ("-h", "--help")
            print(
                "\n".join(f"vantage {command.words:<22}{command.summary}" for command in group),
                file=sys.stdout if asked else sys.stderr,
            )
            sys.exit(0 if asked else 2)
        print(f"vantage: no command `{arguments[0]}`\n\n{overview()}", file=sys.stderr)
        sys.exit(2)
    command, rest = found
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that lacks a letter must not end a command
    sys.exit(run_stoppable(lambda: _run_explained(command, rest), f"vantage {command.words}", command.kept))


def _output_is_closed() -> bool:
    poll = select.poll()
    poll.register(sys.stdout.fileno(), 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


def _run_explained(command: Command, arguments: Sequence[str]) -> int:
    """Run a command; an error that a person can do something about becomes one line and exit code 1."""
    try:
        return run(command, arguments)
    except Exception as error:
        if isinstance(error, BrokenPipeError) and _output_is_closed():
            # The reader of our output has gone, as `head` does; nothing can be said any more.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        line = explain(error)
        if line is None:
            raise
        # Lines may name files and quote strangers.
        print("\n".join(printable(part) for part in f"vantage {command.words}: {line}".splitlines()), file=sys.stderr)
        return 1


if __name__ == "__main__":
    main()
