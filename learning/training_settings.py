"""What people may tell a training, whichever network learns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.compiling import Compile
from learning.dataset import DEFAULT_DATASET
from learning.group import Group
from learning.recipe import Schedule
from vantage.cores import available_cores
from vantage.errors import UserError


class UnusableTraining(UserError, ValueError):
    """What was asked for cannot be trained."""


@dataclass(frozen=True)
class SharedSettings:
    """What every training can be told."""

    data: Path = DEFAULT_DATASET
    """The training set."""
    to: Path | None = None
    """Where the weights go, in runs/ if not said; the model card lies beside them."""
    minutes: float | None = None
    """Train for this long instead of a number of samples."""
    drop: float | None = None
    """Factor of the learning rate: 0.9, 0.5 and 0.1 are the readings of the paper."""
    workspace: Path | None = None
    """Folder of the checkpoint and of the curves for TensorBoard. If not said, it is named after the weights: runs/NAME/ for
    runs/NAME.safetensors. With several --seeds each has a folder inside: WORKSPACE/seed2."""
    resume: bool = True
    """Go on from the checkpoint, if the workspace holds one of this training; else begin again."""
    force: bool = False
    """Replace weights and checkpoint of another training that have the same name."""
    report_every: int = 16_384
    """Samples between validations; the best weights are those with the lowest validation loss."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints."""
    threads: int = 0
    """CPU threads; 0 = all cores."""
    seeds: tuple[int, ...] = (1,)
    """Train once with each of these seeds, one after the other. One seed: the weights are named as `to` says. Several:
    NAME-seed1.safetensors, NAME-seed2.safetensors and so on, which `vantage evaluate` finds by themselves."""

    def __post_init__(self) -> None:
        for name in ("minutes", "samples", "images", "epochs", "batch", "report_every", "validation", "width"):
            value = getattr(self, name, None)
            if value is not None and value <= 0:
                raise UnusableTraining(f"--{name.replace('_', '-')} must be above 0")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds) or min(self.seeds) < 0:
            raise UnusableTraining("--seeds must name different seeds, none below 0")

    def threads_of(self, group: Group) -> int:
        """Return the CPU threads of each process of a group."""
        return self.threads or max(1, available_cores() // group.size)


@dataclass(frozen=True)
class Place:
    """Where one training of a command leaves its results.

    Attributes:
        seed: of the training.
        weights: the safetensors file; the model card lies beside it.
        workspace: folder of checkpoint and curves.
    """

    seed: int
    weights: Path
    workspace: Path


def places_of(settings: SharedSettings, name: str) -> list[Place]:
    """Return where the training of each seed leaves its results.

    Args:
        name: of the weights in runs/, where `to` is not said.
    """
    to = settings.to or Path("runs", f"{name}.safetensors")
    if to.suffix != ".safetensors":
        raise UnusableTraining(f"--to {to} must end in .safetensors")
    if len(settings.seeds) == 1:
        return [Place(settings.seeds[0], to, settings.workspace or to.with_suffix(""))]
    places = []
    for seed in settings.seeds:
        weights = of_seed(to, seed)
        places.append(Place(seed, weights, settings.workspace / f"seed{seed}" if settings.workspace else weights.with_suffix("")))
    return places


def of_seed(weights: Path, seed: int) -> Path:
    """Return the name of the weights that a training with one of several seeds leaves: NAME-seed2.safetensors."""
    return weights.with_name(f"{weights.stem}-seed{seed}{weights.suffix}")


@dataclass(frozen=True)
class TrainingSettings(SharedSettings):
    """What every training on samples of a data set can be told."""

    model: str = ""
    """Each training names its own."""
    preset: str = ""
    """Each training names its own."""
    samples: int | None = None
    """Train on so many samples instead of the preset's number."""
    batch: int | None = None
    """Batch size, instead of the preset's."""
    schedule: Schedule | None = None
    """`steps` multiplies the learning rate by --drop at 25 % and 65 %, `cosine` ends at zero; instead of the preset's."""
    validation: int = 1024
    """Samples of validation games that each of them looks at."""
    compile: Compile = "auto"
    """Compile the network (a third faster); `auto`: where a compiler is there and the training is long enough."""


def given(settings: object, *names: str) -> dict[str, Any]:
    """Return those of the settings that the command line gave, which take the place of the preset's."""
    return {name: value for name in names if (value := getattr(settings, name)) is not None}


def in_words(seeds: Sequence[int]) -> str:
    """Return seeds for people: `seed 1`, or `seeds 1, 2, 3`."""
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"
