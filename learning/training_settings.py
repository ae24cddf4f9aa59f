"""What people may tell a training, whichever network learns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.compiling import Compile
from learning.dataset import DEFAULT_DATASET
from learning.group import Group
from learning.recipe import Schedule
from vantage.cores import available_cores


@dataclass(frozen=True)
class TrainingSettings:
    """What every training on the samples of a data set can be told."""

    model: str
    """Each training names its own."""
    preset: str
    """Each training names its own."""
    data: Path = DEFAULT_DATASET
    """The training set."""
    to: Path | None = None
    """Where the weights go, runs/MODEL.safetensors if not said; the model card lies beside them."""
    minutes: float | None = None
    """Train for this long instead of a number of samples."""
    samples: int | None = None
    """Train on so many samples instead of the preset's number."""
    batch: int | None = None
    """Batch size, instead of the preset's."""
    schedule: Schedule | None = None
    """`steps` multiplies the learning rate by --drop at 25 % and 65 %, `cosine` ends at zero; instead of the preset's."""
    drop: float | None = None
    """Factor of the learning rate: 0.9, 0.5 and 0.1 are the readings of the paper."""
    workspace: Path | None = None
    """Folder of the checkpoint and of the curves for TensorBoard; runs/MODEL if not said."""
    resume: bool = True
    """Go on from the checkpoint, if the workspace holds one."""
    report_every: int = 16_384
    """Samples between validations."""
    validation: int = 1024
    """Samples of validation games that each of them looks at."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints."""
    threads: int = 0
    """CPU threads; 0 = all cores."""
    compile: Compile = "auto"
    """Compile the network (a third faster); `auto`: where a compiler is there and the training is long enough."""
    seed: int = 1

    @property
    def weights(self) -> Path:
        """Where the weights go."""
        return self.to or Path("runs", f"{self.model}.safetensors")

    @property
    def folder(self) -> Path:
        """Where the checkpoint lies."""
        return self.workspace or Path("runs", self.model)

    def threads_of(self, group: Group) -> int:
        """Return the CPU threads of each process of a group."""
        return self.threads or max(1, available_cores() // group.size)


def given(settings: object, *names: str) -> dict[str, Any]:
    """Return those of the settings that the command line gave, which take the place of the preset's."""
    return {name: value for name in names if (value := getattr(settings, name)) is not None}
