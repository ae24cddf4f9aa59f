"""`vantage train vpn`: learn to judge predicted views (paper, Value Prediction Network). Reads from top to bottom."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from learning.dataset import DEFAULT_DATASET, Batch, Dataset, Samples, prefetch
from learning.group import Group, join_group
from learning.measures import measures_of_logits
from learning.recipe import VPN_PRESETS, VpnRecipe, rate_factor, vpn_notes_of
from learning.splits import Split
from learning.tensors import in_unit_range, on_device, shown_to
from learning.trainer import VIEW_ARCHITECTURES, GradientTrainer
from learning.training_run import OtherTraining, TrainingRun, training_samples
from learning.training_settings import given
from vantage.cores import available_cores
from vantage.networks.inference import folded
from vantage.networks.vector_action import VectorAction
from vantage.networks.vpn import Vpn
from vantage.networks.vpt_tob import ViewPredictor
from vantage.networks.weights import ModelCard, fast_precision, load_any, save


@dataclass(frozen=True)
class TrainVpnSettings:
    """Learn to judge the views that a network predicts: is the hider caught?

    Example: vantage train vpn --data dataset/ --views weights/vpt-tob.safetensors --preset compact
    """

    data: Path = DEFAULT_DATASET
    """The training set."""
    views: Path = Path("weights/vpt-tob.safetensors")
    """Weights whose predictions it learns from: of any network that predicts a view."""
    to: Path | None = None
    """Where the weights go, in runs/ if not said; the model card lies beside them."""
    preset: Literal["paper", "compact"] = "paper"
    """`paper`: the paper's recipe. `compact`: a stream of fresh predictions, some minutes on a CPU core."""
    minutes: float | None = None
    """Train for this long instead of on a number of images."""
    images: int | None = None
    """Images to learn from, instead of the preset's number."""
    epochs: int | None = None
    """How often each is seen, instead of the preset's number."""
    width: int | None = None
    """Channels of the first convolution, instead of the preset's."""
    rate: float | None = None
    """Learning rate, instead of the preset's."""
    drop: float | None = None
    """Factor of the learning rate at 20 % and 50 % (preset `paper`): 0.9, 0.5 and 0.1 are the readings of the paper."""
    on: Literal["predictions", "true"] | None = None
    """Learn from predicted or from true views, instead of what the preset says."""
    workspace: Path | None = None
    """Folder of the checkpoint and of the curves for TensorBoard; runs/NAME if not said, as the weights are named."""
    resume: bool = True
    """Go on from the checkpoint, if the workspace holds one."""
    report_every: int = 16_384
    """Images learnt from between validations."""
    validation: int | None = None
    """Views of validation games that each of them looks at, instead of the preset's number."""
    threads: int = 0
    """CPU threads; 0 = all cores."""
    seed: int = 1


def resolve(settings: TrainVpnSettings) -> VpnRecipe:
    """Return the preset with what the command line changes."""
    changed = given(settings, "images", "epochs", "rate", "drop", "on")
    if settings.validation is not None:
        changed["held"] = settings.validation
    recipe = replace(VPN_PRESETS[settings.preset], **changed)
    return replace(recipe, network=replace(recipe.network, width=settings.width)) if settings.width else recipe


class Views:
    """Gives the views that a VPN learns from: predicted, as they are in play, or true.

    Args:
        predictor: None = the true views of the seeker.
    """

    def __init__(self, data: Dataset, predictor: ViewPredictor | None, device: torch.device) -> None:
        self.data, self.device, self.precision = data, device, fast_precision(device)
        self._vectors = isinstance(predictor, VectorAction)
        self._predictor = predictor and folded(predictor).to(device, self.precision).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def render(self, samples: Samples) -> Batch:
        """Return what the predictor is shown."""
        return self.data.render(samples, vectors=self._vectors)

    @torch.inference_mode()
    def of(self, batch: Batch) -> Tensor:
        """Return views, uint8 [B, 128, 128, 3] on the device."""
        if self._predictor is None:
            return on_device(batch.targets, self.device)
        inputs, vectors = on_device(batch.inputs, self.device), on_device(batch.vectors, self.device).to(self.precision)
        views = self._predictor(*shown_to(self._predictor, inputs, vectors, self.precision))
        return views.float().mul(255).round().byte().permute(0, 2, 3, 1).contiguous()

    def gather(self, split: Split, count: int, from_start: float, seed: int, size: int = 64) -> tuple[Tensor, NDArray[np.bool_]]:
        """Return views uint8 [count, 128, 128, 3] of samples of a split, upright, and whether the hider is caught in them."""
        samples = self.data.draw(split, count, np.random.default_rng([seed, count]), from_start, symmetries=1)
        parts = prefetch(lambda: (self.render(samples.part(at, at + size)) for at in range(0, count, size)))
        return torch.cat([self.of(batch) for batch in parts]), samples.caught


Learnt = tuple[Tensor, Tensor]
"""Views uint8 [B, 128, 128, 3], and whether the hider is caught in them, float [B]."""


def repeated(views: Views, recipe: VpnRecipe, seed: int, seen: int) -> Iterator[Learnt]:
    """Yield batches of a fixed set of images, in another order each epoch."""
    images, truth = views.gather("train", recipe.images, recipe.from_start, seed)
    caught = torch.from_numpy(truth).float().to(views.device)
    at = seen
    while True:
        epoch, first = divmod(at, recipe.images)
        order = torch.from_numpy(np.random.default_rng([seed, epoch]).permutation(recipe.images)).to(views.device)
        chosen = order[first : first + recipe.batch]
        yield images[chosen], caught[chosen]
        at += len(chosen)


def streamed(views: Views, recipe: VpnRecipe, seed: int, seen: int) -> Iterator[Learnt]:
    """Yield batches of fresh predictions: each batch that is predicted goes into a pool of the latest ones, from which `epochs`
    batches are drawn."""
    size = recipe.batch
    pool = torch.empty(recipe.pool, 128, 128, 3, dtype=torch.uint8, device=views.device)
    caught = torch.empty(recipe.pool, device=views.device)

    drawn = training_samples(views.data, recipe, seed, itertools.count(seen // (size * recipe.epochs)))
    generator = np.random.default_rng([seed, seen, 1])
    for number, batch in enumerate(prefetch(lambda: map(views.render, drawn))):
        places = torch.arange(number * size, (number + 1) * size, device=views.device) % recipe.pool
        pool[places], caught[places] = views.of(batch), on_device(batch.caught, views.device).float()
        filled = min((number + 1) * size, recipe.pool)
        if filled < min(8 * size, recipe.pool):
            continue
        for _ in range(recipe.epochs):
            chosen = torch.from_numpy(generator.integers(filled, size=size)).to(views.device)
            yield pool[chosen], caught[chosen]


def turned(views: Tensor, symmetries: int, generator: np.random.Generator) -> Tensor:
    """Return views [B, 128, 128, 3] turned by a random quarter, and with 8 symmetries perhaps flipped: the whole batch alike."""
    views = torch.rot90(views, int(generator.integers(4)), (1, 2))
    return views.flip(2) if symmetries == 8 and generator.random() < 0.5 else views


class Trainer(GradientTrainer[Learnt]):
    """A VPN and its loss."""

    network: Vpn

    def __init__(self, recipe: VpnRecipe, group: Group) -> None:
        super().__init__(recipe, group, compiled=False)
        self.network = Vpn(recipe.network).to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.parameters = list(self.network.parameters())
        self.optimizer = torch.optim.Adam(self.parameters, recipe.rate, fused=True)

    def forward(self, views: Tensor) -> Tensor:
        """uint8 [B, 128, 128, 3] -> logits of "caught" [B]."""
        pixels = in_unit_range(views, self.precision).contiguous(memory_format=torch.channels_last)
        with torch.autocast(self.device.type, self.precision, enabled=self.precision != torch.float32):
            return self.network(pixels).float()

    def loss_of(self, batch: Learnt, forward: Callable[..., Tensor]) -> Tensor:
        views, caught = batch
        return functional.binary_cross_entropy_with_logits(forward(views), caught)

    @torch.inference_mode()
    def validate(self, views: Tensor, caught: NDArray[np.bool_], size: int = 256) -> dict[str, float]:
        """Return what can be said of views uint8 [N, 128, 128, 3], judged as in play."""
        self.network.eval()
        parts = [self.network(in_unit_range(part, torch.float32)).cpu() for part in views.split(size)]
        self.network.train()
        scores = torch.cat(parts).numpy()
        return {**measures_of_logits(scores, caught), "majority class": float(max(caught.mean(), 1 - caught.mean()))}


def main(settings: TrainVpnSettings) -> int:
    """Train; returns the exit code."""
    torch.set_num_threads(settings.threads or available_cores())
    torch.manual_seed(settings.seed)
    group, data, recipe = join_group(), Dataset(settings.data), resolve(settings)
    predictor, inputs, name = None, dict[str, str](), "true-vpn"
    if recipe.on == "predictions":
        predictor, predictor_card = load_any(settings.views, VIEW_ARCHITECTURES)
        inputs = {settings.views.name: predictor_card.sha256}
        name = "vpn" if settings.views.stem == "vpt-tob" else f"{settings.views.stem}-vpn"
    to = settings.to or Path("runs", f"{name}.safetensors")
    workspace = settings.workspace or Path("runs", to.stem)
    views = Views(data, predictor, group.device)
    trainer = Trainer(recipe, group)

    identity = {
        "recipe": asdict(replace(recipe, images=0 if recipe.stream else recipe.images)),
        "data": data.hash,
        "views": inputs,
    }
    total = recipe.images * recipe.epochs
    run = TrainingRun(workspace, identity, group, total, settings.minutes, settings.report_every, unit="images")
    try:
        if settings.resume and (saved := run.resume("recipe, training set or predictor")):
            trainer.restore(saved)
    except OtherTraining as error:
        return run.refuse(error)

    held_views, held_caught = views.gather("validation", recipe.held, recipe.from_start, settings.seed)
    how = "a stream of" if recipe.stream else "a fixed set of"
    what = "true views" if predictor is None else f"predictions of {settings.views}"
    run.say(f"{how} {recipe.images:,} {what}, each {recipe.epochs} times; {len(held_caught):,} to validate")
    run.say(f"caught in {held_caught.mean():.1%} of the views to validate")

    def make_card() -> ModelCard:
        seen = {"images seen": run.seen}
        card = run.model_card(trainer.network, settings.preset, data, recipe, seen, settings.seed)
        card.notes, card.inputs = vpn_notes_of(recipe), inputs
        return card

    stream = (streamed if recipe.stream else repeated)(views, recipe, settings.seed, run.seen)
    generator = np.random.default_rng([settings.seed, run.seen, 2])
    run.begin()
    while run.progress < 1.0:
        shown, caught = next(stream)
        loss = trainer.learn((turned(shown, recipe.symmetries, generator), caught), rate_factor(recipe, run.progress))
        run.count(len(caught), loss)
        if run.report_is_due:
            measures = trainer.validate(held_views, held_caught)
            if better := run.keep_if_best(measures):
                save(trainer.network, to, make_card())
            run.write_checkpoint(trainer.state())
            run.report(measures, better, pace=f"{run.minutes_left:4.1f} min left")
    run.finish(to)
    return 0
