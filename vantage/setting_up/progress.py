"""How the set-up talks to people: what is being done while it is, and what to install where something is missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from vantage.setting_up.trouble import TableTrouble

console = Console(highlight=False)


@contextmanager
def progress(doing: str) -> Iterator[Callable[[str], None]]:
    """Show what is being done while it is; gives the function that changes the text."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        task = shown.add_task(escape(doing), total=None)
        yield lambda text: shown.update(task, description=escape(text))


@contextmanager
def cameras_there() -> Iterator[None]:
    """Say what to install where the cameras' packages are missing.

    Raises:
        TableTrouble: one of them is.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise TableTrouble(f"the package {error.name} is missing: pip install 'vantage-hide-and-seek[tracker]'") from error
