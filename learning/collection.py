"""A folder with one collection of games: what decides what its logs hold, which games are there, which are still to be played.

Nothing but the logs themselves says so: the metadata of each names the settings that it was made with, its first seed and how
many games it holds. So a collection goes on, or grows, wherever its logs are, and none of them is ever written again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from learning.stretches import stretches
from vantage.errors import UserError
from vantage.log import open_log
from vantage.log.file import first_metadata

EPOCH = 1_767_225_600_000_000_000  # ns, 2026-01-01: the virtual clock of the game of seed 0
SPACING = 1000 * 1_000_000_000  # ns of virtual time a game may take
LARGEST_SEED = (2**63 - 1 - EPOCH) // SPACING - 1  # stamps are int64

_OPTIONS = {
    "rules.maximum_steps": "--steps",
    "rules.step_period": "--period",
    "rules.start_distance_minimum": "--start-distance",
    "rules.start_distance_maximum": "--start-distance",
}


class OtherCollection(UserError):
    """A folder holds games of other settings; the text names them."""


@dataclass
class Collection:
    """What a folder holds of a collection.

    Attributes:
        seeds: of the games that are there.
        damaged: logs that are cut short or lack messages, whose games do not count.
    """

    seeds: set[int] = field(default_factory=set)
    damaged: list[Path] = field(default_factory=list)


def clock_of(seed: int) -> int:
    """Return the virtual time at which a log begins whose first game has this seed, ns."""
    return EPOCH + seed * SPACING


def plain(settings: Any) -> Any:
    """Return a dataclass as JSON holds it."""
    return json.loads(json.dumps(asdict(settings), default=lambda value: msgspec.to_builtins(value, enc_hook=str)))


def option_of(name: str) -> str:
    """Return the option of `vantage collect` that sets a field of a log's settings."""
    return _OPTIONS.get(name, "--" + name.rpartition(".")[2].replace("_", "-"))


def find_collection(folder: Path, identity: Mapping[str, Any], seeds_from: Callable[[int, int], list[int]]) -> Collection:
    """Return what a folder holds of a collection.

    Args:
        identity: `settings` and `trajectories` of the collection, as the configuration in a log has them.
        seeds_from: (first, count) -> the seeds of its next `count` games.

    Raises:
        OtherCollection: there are games of another collection.
    """
    found = Collection()
    for path in sorted(folder.glob("[!.]*.mcap")):
        metadata = first_metadata(path)
        configuration = _configuration_in(metadata)
        if configuration is None:
            continue  # of a table, or of another program
        if different := _differences(configuration, identity):
            raise OtherCollection(
                f"{folder} holds games that were collected with other settings ({different}): choose another folder with --to"
            )
        if is_whole(path):
            found.seeds.update(seeds_from((int(metadata["started"]) - EPOCH) // SPACING, configuration["games"]))
        else:
            found.damaged.append(path)
    return found


def is_whole(path: Path) -> bool:
    """Return whether a log was closed properly and no message of it is known to be lost."""
    with open_log(path) as log:
        return all(file.finished for file in log.files) and not log.breaks and not log.gaps


def missing_blocks(seeds: Sequence[int], held: Iterable[int], block: int) -> list[list[int]]:
    """Return the seeds of each log that is still to be written, so that with what is held all of `seeds` are there.

    Logs hold `block` games each, fewer where some of a block are there already: a log's games follow each other in `seeds`.
    """
    there = set(held)
    missing = [place for place, seed in enumerate(seeds) if seed not in there]
    by_block: dict[int, list[int]] = {}
    for place in missing:
        by_block.setdefault(place // block, []).append(place)
    return [[seeds[place] for place in run] for places in by_block.values() for run in stretches(places)]


def _configuration_in(metadata: Mapping[str, str]) -> dict[str, Any] | None:
    """Return the configuration in a log of a collection; None for any other log."""
    try:
        found = json.loads(metadata.get("configuration", "{}"))
        if isinstance(found["settings"], dict) and isinstance(found["games"], int) and int(metadata["started"]) >= EPOCH:
            return dict(found)
    except (ValueError, KeyError, TypeError):
        pass
    return None


def _differences(held: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return in words which settings of a log are others than those that are wanted; empty when all are the same."""
    there, here = _flat(held["settings"]), _flat(wanted["settings"])
    lines = [f"{option_of(name)} {there.get(name)}, not {value}" for name, value in here.items() if there.get(name) != value]
    if not lines and (held.get("trajectories") or "") != wanted["trajectories"]:
        lines.append("other trajectories are replayed: --from, --driver")
    return "; ".join(lines)


def _flat(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in nested.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat
