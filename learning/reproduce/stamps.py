"""What was made by which command from what: a stage whose stamp still holds is not run again."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from learning.reproduce.stages import Stage
from vantage.output import write_complete


@dataclass
class Stamp:
    """One stage's record, `stamps/STAGE.json`.

    Attributes:
        key: hash of the arguments and of everything that went in.
        command: as it was typed.
        products: hash of each, by its name in the stage.
        began: seconds since the Unix epoch.
        seconds: that it ran.
        provenance: commit and hardware.
        taken_from: the folder of an earlier reproduction, where it was made there.
        resumed: whether it went on with what an interrupted run had left: `seconds` is then of the last run alone.
    """

    key: str
    command: str
    products: dict[str, str]
    began: float = 0.0
    seconds: float = 0.0
    provenance: dict[str, Any] = field(default_factory=dict)
    taken_from: str = ""
    resumed: bool = False


class Stamps:
    """The stamps of one reproduction's folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._resumed: dict[str, bool] = {}

    def path_of(self, place: str) -> Path:
        """Return where `@/...` is."""
        return Path(str(self.folder) + place.removeprefix("@"))

    def _file(self, stage: Stage, ending: str) -> Path:
        return self.folder / "stamps" / f"{file_name(stage)}.{ending}"

    def key(self, stage: Stage, stages: dict[str, Stage]) -> str:
        """Return the hash of what decides the stage's products: its arguments and what it needs."""
        inputs = {need: [_hash(self.path_of(product)) for product in stages[need].products] for need in stage.needs}
        read = {f"{path.parent.name}/{path.name}": _hash(path) for path in stage.reads}
        return hashlib.sha256(json.dumps([stage.arguments, stage.products, inputs, read]).encode()).hexdigest()

    def read(self, stage: Stage) -> Stamp | None:
        """Return the stamp of a finished stage."""
        try:
            return Stamp(**json.loads(self._file(stage, "json").read_text()))
        except (OSError, ValueError, TypeError):
            return None

    def holds(self, stage: Stage, key: str) -> bool:
        """Whether the stage is done: same key, and its products are the files that it left."""
        stamp = self.read(stage)
        return stamp is not None and stamp.key == key and stamp.products == self._products(stage)

    def _products(self, stage: Stage) -> dict[str, str]:
        return {product: _hash(self.path_of(product)) for product in stage.products}

    def missing(self, stage: Stage) -> list[Path]:
        """Return products that are not there."""
        return [path for product in stage.products if not (path := self.path_of(product)).is_file()]

    def begin(self, stage: Stage, key: str) -> None:
        """Note that the stage begins. Half-done work of other arguments or inputs is thrown away; of the same, it goes on.

        What lies there and was not begun here is left alone: a command itself refuses what it cannot go on with.
        """
        begun, stamp = self._file(stage, "begun"), self.read(stage)
        earlier = begun.read_text() if begun.is_file() else stamp.key if stamp else key
        self._resumed[stage.name] = begun.is_file() and earlier == key
        self._file(stage, "json").unlink(missing_ok=True)
        if earlier != key:
            for place in stage.scratch:
                shutil.rmtree(self.path_of(place), ignore_errors=True)
            for product in stage.products:
                self.path_of(product).unlink(missing_ok=True)
        write_complete(begun, key)

    def finish(self, stage: Stage, key: str, command: str, seconds: float, provenance: dict[str, Any]) -> None:
        """Stamp a stage whose products are there."""
        stamp = Stamp(key, command, self._products(stage), time.time() - seconds, seconds, provenance)
        stamp.resumed = self._resumed.pop(stage.name, False)
        self._write(stage, stamp)

    def _write(self, stage: Stage, stamp: Stamp) -> None:
        write_complete(self._file(stage, "json"), json.dumps(asdict(stamp), indent=2) + "\n")
        self._file(stage, "begun").unlink(missing_ok=True)

    def take_over(self, stage: Stage, key: str, other: Path) -> bool:
        """Take a stage's products from another reproduction, if they were made there by the same command from the same."""
        theirs = Stamps(other)
        if other.resolve() == self.folder.resolve() or not theirs.holds(stage, key):
            return False
        self.begin(stage, key)
        for source in (theirs.path_of(place) for place in (*stage.products, *stage.whole)):
            for path in _files(source):
                target = self.folder / path.relative_to(other)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.unlink(missing_ok=True)
                _link(path, target)
        stamp = theirs.read(stage)
        assert stamp is not None
        stamp.taken_from = stamp.taken_from or str(other)
        self._write(stage, stamp)
        return True


def file_name(stage: Stage) -> str:
    """Return the stage's name as a file's."""
    return stage.name.replace(" ", "-").replace("/", "-")


def _files(path: Path) -> Iterator[Path]:
    yield from (inner for inner in sorted(path.rglob("*")) if inner.is_file()) if path.is_dir() else (path,)


def _link(source: Path, target: Path) -> None:
    with suppress(OSError):
        os.link(source, target)
        return
    shutil.copy2(source, target)


ASIDE = ("command", "commit", "commits of the logs", "when")
"""What a data set's manifest says that is not about what the set holds."""


def _hash(path: Path) -> str:
    """Return the SHA-256 of a file, empty where there is none; of a data set's manifest, of what it says of the data."""
    try:
        if path.name == "manifest.json":
            content = {key: value for key, value in json.loads(path.read_text()).items() if key not in ASIDE}
            return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""
