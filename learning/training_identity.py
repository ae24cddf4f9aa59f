"""Which training is which: all that decides what a training comes to, so that none is ever taken for another."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from learning.dataset import Dataset
from learning.group import Group
from learning.recipe import CaughtRecipe, Recipe, VpnRecipe
from learning.training_settings import SharedSettings
from vantage.errors import UserError


class OtherTraining(UserError, ValueError):
    """Checkpoint or weights are those of another training; the text says in what it differs and what to do."""


def identity_of(
    settings: SharedSettings, seed: int, group: Group, data: Dataset, recipe: Recipe | CaughtRecipe | VpnRecipe, **more: Any
) -> dict[str, Any]:
    """Return all that decides what a training comes to: two with the same identity are one training.

    Excludes what does not change the result: threads, compiling, where the training set is rendered, the device and its precision
    (the same sums, rounded otherwise), when checkpoints are written, the commit (it changes with every edit of a page; the
    card names it), and names. Excludes the length, too (samples, minutes, and the images of a stream): a training that goes
    on for longer is still the same one, and its card says how long it was.

    Args:
        recipe: without its length.
        more: the model, the validation's size, the hashes of weights that go in.
    """
    return {
        "seed": seed,
        "recipe": asdict(recipe),
        "data": data.hash,
        "report every": settings.report_every,  # the best weights are looked for at each report
        "processes": group.size,  # each adds a batch to every step
        **more,
    }


def digest_of(identity: Mapping[str, Any]) -> str:
    """Return the hash of an identity, which stands in the model card."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


def differences(there: Mapping[str, Any], here: Mapping[str, Any], most: int = 3) -> str:
    """Return in what two identities differ, for people; empty where they are the same."""
    a, b = dict(_flat(there)), dict(_flat(here))
    texts = [
        f"{name} {_short(a.get(name, 'unknown'))} there, {_short(b.get(name, 'none'))} here"
        for name in {**b, **a}
        if (name in a, a.get(name)) != (name in b, b.get(name))
    ]
    return "; ".join(texts[:most]) + (f"; {len(texts) - most} more" if len(texts) > most else "")


def _flat(identity: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in identity.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name} ")
        else:
            yield f"{prefix}{name}", tuple(value) if isinstance(value, list) else value


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 32 else f"{text[:12]}…"
