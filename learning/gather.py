"""`vantage gather`: one whole training set in one folder: evader recordings, a mixture of hiders, exact split sizes.

    DIR/evader          logs of the scripted evader, catches ignored: trajectories to be replayed
    DIR/logs/HIDER      logs of the mixture
    DIR/dataset         the training set
    DIR/manifest.json   settings, commit, seeds, hashes: what it takes to make the same set again, bit for bit

Each policy has seeds of its own, the same ones for every seeker, layout and length: games of one seed have one start, whatever
else differs, so sets of several kinds can be compared start by start and agree on what is test.
"""

from __future__ import annotations

import json
import math
import shlex
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from learning.collect import CollectSettings, logs_of
from learning.collect import main as collect
from learning.convert import convert, messages_hash, summary_of, warn_of_empty_splits
from learning.dataset_tables import Sizes, TooFewGames, by_split
from learning.splits import SPLITS, split_of
from vantage.errors import UserError
from vantage.log import open_log, source_commit
from vantage.log.file import first_metadata
from vantage.match import SeekerPreset
from vantage.output import AlreadyExists, write_complete
from vantage.printable import counted

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Part:
    """One row of the mixture.

    Attributes:
        share: of the games.
        first_seed: of its games, from the first seed of the set.
    """

    share: float
    first_seed: int


MIXTURE: dict[str, Part] = {
    "goal-walk": Part(0.65, 0),
    "random": Part(0.13, 100_000),
    "replay": Part(0.22, 200_000),  # of the scripted evader at skills 1 to 3, each within the split it was recorded in
}
"""Hider -> its part in every split."""

EVADER_FIRST_SEED = 300_000
SEEDS = 100_000
"""Seeds that each policy has for itself; a set takes none at or above its first seed + 4 * SEEDS."""

REPLAYS_PER_RECORDING = 2
ROUNDS = 5  # of playing games in place of those that cannot serve


@dataclass(frozen=True)
class GatherSettings:
    """Gather a whole training set: plays the games, converts them, cuts each split to size. Run it again to go on.

    Examples:
      vantage gather --to data/
      vantage gather --seeker expert --layout lab --to data/expert-lab
      vantage gather --steps 350 --train 450 --validation 50 --test 50 --to data/long
    """

    to: Path = Path("data")
    """Folder of the set; the training set is in its `dataset`."""
    seeker: SeekerPreset = "glancing"
    """Preset of the seeker."""
    layout: Literal["random", "lab"] = "random"
    """Boxes drawn anew for each game, or the fixed ones."""
    steps: int = 200
    """Length of a game: the hider survives when this step is reached."""
    train: int = 4500
    """Games to train on."""
    validation: int = 500
    """Games to validate on."""
    test: int = 500
    """Games to test on."""
    seed: int = 1
    """First seed. The split of a game goes by its seed."""
    block: int = 50
    """Games per log."""
    workers: int = 0
    """Worker processes; 0 = one for each core."""


class Refusal(UserError, ValueError):
    """A set that cannot be made so; the text says why."""


def sizes_by_hider(sizes: Sizes) -> dict[str, Sizes]:
    """Return how many games of each hider each split has: the shares of the mixture, rounded by largest remainder."""
    by_split = []
    for size in sizes:
        exact = {hider: size * part.share for hider, part in MIXTURE.items()}
        whole = {hider: math.floor(count + 1e-9) for hider, count in exact.items()}
        for hider in sorted(exact, key=lambda hider: whole[hider] - exact[hider])[: size - sum(whole.values())]:
            whole[hider] += 1
        by_split.append(whole)
    train, validation, test = by_split
    return {hider: (train[hider], validation[hider], test[hider]) for hider in MIXTURE}


def games_needed(first: int, wanted: Sizes) -> int:
    """Return how many seeds from `first` on it takes until every split has as many as wanted.

    Raises:
        Refusal: more than a policy has.
    """
    left = list(wanted)
    for games in range(SEEDS + 1):
        if max(left) <= 0:
            return games
        left[split_of(first + games)] -= 1
    raise Refusal(f"more than {SEEDS:,} games of one hider are needed: gather less")


def plan(settings: GatherSettings, wanted: dict[str, Sizes], spare: dict[str, Sizes]) -> dict[str, CollectSettings]:
    """Return what is to be collected, `evader` and each hider of the mixture, in whole logs.

    Args:
        wanted: hider -> games by split.
        spare: those to make up for games that cannot serve; no recording is added for them, as that would change every replay.
    """
    evader_seed = settings.seed + EVADER_FIRST_SEED
    whole_logs = sum(wanted["replay"]) // REPLAYS_PER_RECORDING // settings.block
    recordings = max(whole_logs * settings.block, games_needed(evader_seed, (1, 1, 1)))

    def of(hider: str, first: int, games: int, folder: str, source: Path | None = None) -> CollectSettings:
        return CollectSettings(
            games=math.ceil(games / settings.block) * settings.block,
            hider=hider,
            seeker=settings.seeker,
            to=settings.to / folder,
            source=source,
            seed=first,
            steps=settings.steps,
            layout=settings.layout,
            workers=settings.workers,
            block=settings.block,
        )

    evader = replace(of("scripted", evader_seed, recordings, "evader"), catching=False)
    mixture = {
        hider: of(hider, first, games, f"logs/{hider}", evader.to if hider == "replay" else None)
        for hider, part in MIXTURE.items()
        for first in [settings.seed + part.first_seed]
        if (games := games_needed(first, _sum(wanted[hider], spare[hider])))
    }
    return {**({"evader": evader} if "replay" in mixture else {}), **mixture}


def _sum(some: Sizes, more: Sizes) -> Sizes:
    return some[0] + more[0], some[1] + more[1], some[2] + more[2]


def identity_of(settings: GatherSettings) -> dict[str, Any]:
    """Return the settings that decide what the set holds: not where or on how many cores it is made."""
    portable = asdict(replace(settings, to=Path(), workers=0))
    return {name: value for name, value in portable.items() if name not in ("to", "workers")}


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a set; empty where none is."""
    try:
        manifest: dict[str, Any] = json.loads((folder / "manifest.json").read_text())
    except FileNotFoundError:
        return {}
    except ValueError:
        raise Refusal(f"{folder / 'manifest.json'} cannot be read: remove it to go on with what lies beside it") from None
    return manifest


def write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    """Write the manifest as a whole or not at all."""
    write_complete(folder / "manifest.json", json.dumps(manifest, indent=2) + "\n")


def is_finished(folder: Path, manifest: dict[str, Any]) -> bool:
    """Return whether the set is whole: its training set is the one that the manifest names."""
    try:
        dataset = json.loads((folder / "dataset" / "manifest.json").read_text())
    except (OSError, ValueError):
        return False
    return "dataset" in manifest and dataset.get("hash") == manifest["dataset"]["hash"]


def differences(held: object, wanted: dict[str, Any]) -> str:
    """Return in words which settings of a set that is there are others than those that are wanted."""
    there = held if isinstance(held, dict) else {}
    return "; ".join(f"--{name} {there.get(name)}, not {value}" for name, value in wanted.items() if there.get(name) != value)


def main(settings: GatherSettings) -> int:
    """Gather; returns the exit code."""
    sizes: Sizes = (settings.train, settings.validation, settings.test)
    if min(sizes) < 0 or sum(sizes) == 0 or settings.steps < 1 or settings.block < 1 or settings.workers < 0:
        raise Refusal("sizes and --workers must not be negative, nor all sizes zero; --steps and --block must be at least 1")
    manifest = read_manifest(settings.to)
    if not manifest and (settings.to / "dataset").exists():
        raise AlreadyExists(settings.to / "dataset", "it is not of this set: choose another --to")
    begun: dict[str, Any] = {"schema_version": SCHEMA_VERSION, "settings": identity_of(settings)}
    if manifest and {name: manifest.get(name) for name in begun} != begun:
        different = differences(manifest.get("settings"), begun["settings"]) or "by another version"
        raise Refusal(f"{settings.to} holds another set ({different}): choose another --to")
    if is_finished(settings.to, manifest):
        made = manifest["dataset"]
        print(f"{settings.to / 'dataset'} is finished: {by_split(made['episodes'].values())} games, hash {made['hash']}")
        return 0
    wanted = sizes_by_hider(sizes)
    spare: dict[str, Sizes] = dict.fromkeys(wanted, (0, 0, 0))
    plan(settings, wanted, spare)  # refuses what cannot be, before anything is written
    settings.to.mkdir(parents=True, exist_ok=True)
    write_manifest(settings.to, begun)
    for _ in range(ROUNDS):
        collections = plan(settings, wanted, spare)
        for number, (name, collection) in enumerate(collections.items(), 1):
            print(f"{number} of {len(collections) + 1}: {counted(collection.games, 'game')}, {name}", flush=True)
            collect(collection)
        print(f"{len(collections) + 1} of {len(collections) + 1}: conversion", flush=True)
        logs = [path for name, collection in collections.items() if name != "evader" for path in logs_of(collection)]
        try:
            dataset = convert(logs, settings.to / "dataset", settings.workers, wanted=wanted, force=True, need_every_log=True)
            break
        except TooFewGames as shortage:
            spare |= {hider: _sum(spare[hider], lacking) for hider, lacking in shortage.lacking.items()}
            print("some games cannot serve: more are played in their place", flush=True)
    else:
        raise Refusal(f"after {ROUNDS} rounds, too few games can serve: see what `vantage convert` leaves out")
    evader = logs_of(collections["evader"]) if "evader" in collections else []
    hashes = {f"evader/{path.name}": hash_of(path) for path in evader}
    hashes |= {f"logs/{path.parent.name}/{path.name}": dataset["logs"][path.name] for path in logs}
    size = sum(path.stat().st_size for path in (settings.to / "dataset").iterdir())
    write_manifest(
        settings.to,
        {
            **begun,
            "command": shlex.join(["vantage", "gather", *sys.argv[2:]]),
            "commit": source_commit(),
            "commits of the logs": sorted({commit_of(path) for path in (*evader, *logs)}),
            "mixture": {hider: part.share for hider, part in MIXTURE.items()},
            "seeds": {name: {"first": made.seed, "games": made.games} for name, made in collections.items()},
            "by split": {hider: dict(zip(SPLITS, counts, strict=True)) for hider, counts in wanted.items()},
            "left_out": dataset["left_out"],
            "dataset": {**{name: dataset[name] for name in ("hash", "episodes", "steps", "caught")}, "bytes": size},
            "logs": hashes,
        },
    )
    warn_of_empty_splits(dataset)
    print(f"{summary_of(dataset)}, {size / 1e6:,.0f} MB, hash {dataset['hash']}, in {settings.to / 'dataset'}")
    return 0


def hash_of(path: Path) -> str:
    """Return the hash of a log's messages.

    Raises:
        Refusal: it is damaged.
    """
    with open_log(path) as log:
        found = messages_hash(log)
        if log.breaks:
            raise Refusal(f"{log.breaks[0]}: remove this log and run it again, its games are then played again")
    return found


def commit_of(path: Path) -> str:
    """Return the commit of the code that made a log."""
    return first_metadata(path).get("commit", "")
