"""What a command of `vantage table` would replace: it is kept beside, under a name with its date."""

from __future__ import annotations

import datetime
import os
from pathlib import Path

from vantage.output import write_complete


def keep_former(path: Path, content: bytes | None = None) -> str:
    """Copy the file at `path`, if there is one, to a dated name beside it. Returns the end of a line that says so.

    Args:
        content: what is to be written there; a file that holds the same already is not copied.
    """
    if not path.is_file():
        return ""
    former = path.read_bytes()
    if former == content:
        return ""
    changed = datetime.datetime.fromtimestamp(path.stat().st_mtime).strftime("%Y-%m-%d-%H%M%S")
    number = 1
    while os.path.lexists(kept := path.with_name(f"{path.stem}-{changed}{f'-{number}' * (number > 1)}{path.suffix}")):
        if kept.is_file() and kept.read_bytes() == former:
            break
        number += 1
    else:
        write_complete(kept, former, replace=False)
    return f" (the former one is kept as {kept.name})"
