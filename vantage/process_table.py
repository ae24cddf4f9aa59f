"""The process table of a deployment: a supervisord configuration, read and completed for one start."""

from __future__ import annotations

import configparser
import re
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from vantage.errors import UserError
from vantage.printable import printable


class ConfigurationError(UserError):
    """A process table cannot be completed as it was asked for."""


@dataclass(frozen=True, slots=True)
class Program:
    """One row of the process table."""

    name: str
    command: tuple[str, ...]
    priority: int


def programs_of(configuration: Path) -> dict[str, Program]:
    """Return the process table of a supervisord configuration, in order of start."""
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";", "#"))
    parser.read_string(configuration.read_text())
    programs = [
        Program(
            name=section.removeprefix("program:"),
            command=tuple(shlex.split(parser[section]["command"].replace("%%", "%"))),
            priority=int(parser[section].get("priority", "999")),
        )
        for section in parser.sections()
        if section.startswith("program:")
    ]
    return {program.name: program for program in sorted(programs, key=lambda program: program.priority)}


def with_extra_arguments(text: str, extra: Mapping[str, str]) -> str:
    """Return the text of a supervisord configuration with arguments added at the end of some programs' commands.

    The arguments are split as a shell does and reach the program as they are: supervisord expands and strips nothing of them.

    Raises:
        ConfigurationError: a program is not in the configuration, or a quotation has no end.
    """
    waiting = {name: _literal(name, arguments) for name, arguments in extra.items()}
    lines = []
    program, known = "", []
    for line in text.splitlines():
        header = re.match(r"\s*\[program:([^\]]+)\]", line)
        if line.lstrip().startswith("["):
            program = header.group(1) if header else ""
            known += [program] if program else []
        if program in waiting and re.match(r"command\s*=", line):
            line = f"{line} {waiting.pop(program)}"
        lines.append(line)
    if waiting:
        raise ConfigurationError(
            f"no such service in this deployment: {printable(', '.join(sorted(waiting)))} (--with); there is: {', '.join(known)}"
        )
    return "\n".join(lines) + "\n"


def _literal(name: str, arguments: str) -> str:
    """Return arguments in the form in which supervisord's parser hands them on unchanged."""
    try:
        words = shlex.split(arguments)
    except ValueError as error:
        raise ConfigurationError(f"--with {printable(name)}: {str(error).lower()} in {printable(arguments)!r}") from None
    if not all(word.isprintable() for word in words):
        raise ConfigurationError(f"--with {printable(name)}: arguments are one line of printable text, not {arguments!r}")
    # A `;` or `#` after a space would begin a comment, also within quotes.
    quoted = re.sub(r" (?=[;#])", " ''", shlex.join(words))
    return quoted.replace("%", "%%")


def with_this_interpreter(text: str) -> str:
    """Return the text of a configuration whose commands find this Python: `python` alone where that leads to it."""
    interpreter = Path(sys.executable)
    if (interpreter.parent / "python").exists():
        return text  # supervisord searches this folder first
    quoted = shlex.quote(str(interpreter)).replace("%", "%%")
    return re.sub(r"(?m)^(command\s*=\s*)python(?=\s)", lambda found: found.group(1) + quoted, text)
