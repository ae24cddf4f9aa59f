"""What every part of a log says first: which code, configuration, weights and schemas made it."""

from __future__ import annotations

import subprocess
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

from schemas.evolution import SCHEMA_VERSION
from schemas.json_schema import schema_hash

RUN = "vantage"
"""Name of the metadata record with the run's metadata."""
GAPS = "vantage.gaps"
"""Name of the metadata record with the lost messages of a part: `key publisher` -> count."""
PART = "part"
"""Field of the run's metadata: number of the part, in logs that have several."""
EXPORTED = "exported"
"""Field of the run's metadata: for which program a file is a copy of a log; not there in logs themselves."""
NEXT = "vantage.next"
"""Name of the metadata record of a part that is followed by another; its field `part` is that one's number."""
REPEATED = "repeated"
"""Mark of a channel that repeats latched messages of the part before."""
VIEWER_PREFIX = "viewer/"
"""Topics below it are translations for Foxglove, Lichtblick and Rerun."""


def source_commit() -> str:
    """Return the commit of the source tree this code runs from, with `+` when it was edited; empty outside a checkout."""
    folder = Path(__file__).resolve().parent
    try:
        commit = subprocess.run(["git", "-C", folder, "rev-parse", "HEAD"], capture_output=True, text=True, timeout=5, check=True)
        edits = subprocess.run(
            ["git", "-C", folder, "status", "--porcelain", "--untracked-files=no"], capture_output=True, text=True, timeout=5
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return commit.stdout.strip() + ("+" if edits.stdout.strip() else "")


@dataclass(frozen=True, slots=True)
class RunMetadata:
    """The run's metadata.

    Attributes:
        commit: of the source tree (`source_commit()`), empty when unknown.
        configuration: the resolved configuration, as JSON text.
        weights: hash of the network weights that may answer, empty when none.
        arena: name of the arena on the bus.
        started: ns since the Unix epoch.
        schema_hash: of all message types.
        schema_version: see `schemas.evolution`.
    """

    commit: str = ""
    configuration: str = "{}"
    weights: str = ""
    arena: str = "table"
    started: int = field(default_factory=time.time_ns)
    schema_hash: str = field(default_factory=schema_hash)
    schema_version: int = SCHEMA_VERSION

    def as_text(self) -> dict[str, str]:
        """Return the fields as MCAP wants them: text to text."""
        return {name: str(value) for name, value in asdict(self).items()}
