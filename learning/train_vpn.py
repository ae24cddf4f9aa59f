"""`vantage train vpn`: learn to judge predicted views (paper, Value Prediction Network). Reads from top to bottom."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from learning.dataset import Batch, Dataset, Samples, prefetch
from learning.group import Group, join_group
from learning.measures import measures_of_logits
from learning.methods.trainings import RELEASED, RUNS, files_of
from learning.recipe import VPN_PRESETS, VpnRecipe, rate_factor, vpn_notes_of
from learning.splits import Split
from learning.tensors import in_unit_range, on_device, shown_to
from learning.trainer import VIEW_ARCHITECTURES, GradientTrainer
from learning.training_identity import identity_of
from learning.training_run import TrainingRun, training_samples
from learning.training_settings import Place, SharedSettings, UnusableTraining, given, of_seed, places_of
from vantage.networks.inference import folded
from vantage.networks.vector_action import VectorAction
from vantage.networks.vpn import Vpn
from vantage.networks.vpt_tob import ViewPredictor
from vantage.networks.weights import ModelCard, fast_precision, load_any


@dataclass(frozen=True)
class TrainVpnSettings(SharedSettings):
    """Learn to judge the views that a network predicts: is the hider caught?

    Example: vantage train vpn --preset compact
    """

    views: Path | None = None
    """Weights whose predictions it learns from, of any network that predicts a view; if not said, runs/vpt-tob.safetensors where
    a training has left them, else the released ones. With several --seeds each learns from those of its own seed, where they lie
    beside: vpt-tob-seed2.safetensors; so does a single seed where there are no others."""
    preset: Literal["paper", "compact"] = "paper"
    """`paper`: the paper's recipe. `compact`: a stream of fresh predictions, some minutes on a CPU core."""
    images: int | None = None
    """Images to learn from, instead of the preset's number."""
    epochs: int | None = None
    """How often each is seen, instead of the preset's number."""
    width: int | None = None
    """Channels of the first convolution, instead of the preset's."""
    rate: float | None = None
    """Learning rate, instead of the preset's."""
    on: Literal["predictions", "true"] | None = None
    """Learn from predicted or from true views, instead of what the preset says."""
    validation: int | None = None
    """Views of validation games that each validation looks at, instead of the preset's number."""


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

    def __init__(self, recipe: VpnRecipe, group: Group, seed: int) -> None:
        super().__init__(recipe, group, compiled=False)
        torch.manual_seed(seed)
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
    def validate(self, views: Iterable[Tensor], caught: NDArray[np.bool_]) -> dict[str, float]:
        """Return the measures of views, judged as in play: parts uint8 [n, 128, 128, 3] of N in all."""
        self.network.eval()
        parts = [self.network(in_unit_range(part, torch.float32)).cpu() for part in views]
        self.network.train()
        scores = torch.cat(parts).numpy()
        return {**measures_of_logits(scores, caught), "majority class": float(max(caught.mean(), 1 - caught.mean()))}


def name_of(views: Path) -> str:
    """Return the name of the VPN that judges some weights' views: vpn for vpt-tob, hence vpn-seed2 for vpt-tob-seed2."""
    stem, dash, seed = views.stem.partition("-seed")
    return ("vpn" if stem == "vpt-tob" else f"{stem}-vpn") + dash + seed


def default_views() -> Path:
    """Return the weights of VPT-TOB whose predictions are learnt from where none are named."""
    return (RUNS if files_of("vpt-tob", RUNS) else RELEASED) / "vpt-tob.safetensors"


def views_of(settings: TrainVpnSettings, place: Place) -> Path:
    """Return the weights whose predictions the VPN of a seed learns from."""
    views = settings.views or default_views()
    own = [of_seed(views, seed) for seed in settings.seeds]
    there = [path.exists() for path in own]
    if len(own) == 1:
        return own[0] if there[0] and not views.exists() else views
    if not any(there):
        return views
    if not all(there):
        raise UnusableTraining(f"no weights at {own[there.index(False)]}: there are some of another seed, so each needs its own")
    return own[settings.seeds.index(place.seed)]


def main(settings: TrainVpnSettings) -> int:
    """Train, with one seed after the other; returns the exit code."""
    recipe = resolve(settings)
    places = places_of(settings, "true-vpn" if recipe.on == "true" else name_of(settings.views or default_views()))
    group, data = join_group(), Dataset(settings.data)
    torch.set_num_threads(settings.threads_of(group))
    for place in places:
        train(settings, recipe, place, group, data)
    group.leave()
    return 0


def train(settings: TrainVpnSettings, recipe: VpnRecipe, place: Place, group: Group, data: Dataset) -> None:
    """Train with one seed, or go on with it."""
    predictor, inputs, seed, what = None, dict[str, str](), place.seed, "true views"
    if recipe.on == "predictions":
        path = views_of(settings, place)
        predictor, predictor_card = load_any(path, VIEW_ARCHITECTURES)
        inputs, what = {path.name: predictor_card.sha256}, f"predictions of {path}"
    trainer = Trainer(recipe, group, seed)

    # Of a stream, the number of images is its length; a fixed set of another size is another set.
    plain = replace(recipe, images=0 if recipe.stream else recipe.images)
    identity = identity_of(settings, seed, group, data, plain, views=sorted(inputs.values()))
    run = TrainingRun.of(settings, place, identity, group, recipe.images * recipe.epochs, unit="images")
    how = "a stream of" if recipe.stream else "a fixed set of"
    run.introduce(
        f"vpn `{settings.preset}`", data, trainer.network, f"{how} {recipe.images:,} {what}, each {recipe.epochs} times"
    )
    if saved := run.resume(settings.resume):
        trainer.restore(saved)
    if run.is_over:
        return

    views = Views(data, predictor, group.device)
    held_views, held_caught = views.gather("validation", recipe.held, recipe.from_start, seed)
    run.say(f"{len(held_caught):,} views to validate, the hider is caught in {held_caught.mean():.1%} of them")
    stream = (streamed if recipe.stream else repeated)(views, recipe, seed, run.seen)
    generator = np.random.default_rng([seed, run.seen, 2])

    def step() -> tuple[int, Tensor]:
        shown, caught = next(stream)
        factor = rate_factor(recipe, run.progress)
        return len(caught), trainer.learn((turned(shown, recipe.symmetries, generator), caught), factor)

    def make_card() -> ModelCard:
        card = run.model_card(trainer.network, settings.preset, data, recipe, vpn_notes_of(recipe))
        card.inputs = inputs
        return card

    def validate() -> dict[str, float]:
        return trainer.validate(run.interruptible(held_views.split(256)), held_caught)

    run.train(step, validate, trainer.network, make_card, trainer.state)
    run.finish()
