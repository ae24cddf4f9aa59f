"""`vantage train vpn`: learn to judge predicted views (paper, Value Prediction Network). Reads from top to bottom."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from learning.board import Board
from learning.dataset import Batch, Dataset, Samples, prefetch
from learning.group import join_group
from learning.measures import accuracy, area_under_roc, balanced_accuracy
from learning.recipe import VPN_PRESETS, VpnRecipe, rate_factor, vpn_notes_of
from learning.splits import Split
from learning.tensors import in_unit_range, on_device, shown_to
from learning.trainer import VIEW_ARCHITECTURES
from vantage.log import source_commit
from vantage.networks.inference import folded
from vantage.networks.vector_action import VectorAction
from vantage.networks.vpn import Vpn
from vantage.networks.vpt_tob import ViewPredictor
from vantage.networks.weights import card_of, fast_precision, load_any, save


@dataclass(frozen=True)
class TrainVpnSettings:
    """Learn to judge the views that a network predicts: is the hider caught?

    Example: vantage train vpn --data dataset/ --views weights/vpt-tob.safetensors --preset compact
    """

    data: Path = Path("dataset")
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
    names = ("images", "epochs", "rate", "drop", "on")
    changed = {name: value for name in names if (value := getattr(settings, name)) is not None}
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

    def rendered() -> Iterator[Batch]:
        number = seen // (size * recipe.epochs)
        while True:
            generator = np.random.default_rng([seed, number])
            drawn = views.data.draw("train", size, generator, recipe.from_start, symmetries=recipe.symmetries)
            yield views.render(drawn)
            number += 1

    generator = np.random.default_rng([seed, seen, 1])
    for number, batch in enumerate(prefetch(rendered)):
        places = torch.arange(number * size, (number + 1) * size, device=views.device) % recipe.pool
        pool[places], caught[places] = views.of(batch), on_device(batch.caught, views.device).float()
        filled = min((number + 1) * size, recipe.pool)
        if filled < min(8 * size, recipe.pool):
            continue
        for _ in range(recipe.epochs):
            chosen = torch.from_numpy(generator.integers(filled, size=size)).to(views.device)
            yield pool[chosen], caught[chosen]


@torch.inference_mode()
def judge(network: Vpn, views: Tensor, size: int = 256) -> NDArray[np.float32]:
    """Return the logits of "caught" [N] for views uint8 [N, 128, 128, 3]."""
    network.eval()
    parts = [network(in_unit_range(views[at : at + size], torch.float32)).cpu() for at in range(0, len(views), size)]
    network.train()
    return torch.cat(parts).numpy()


def main(settings: TrainVpnSettings) -> int:
    """Train; returns the exit code."""
    torch.set_num_threads(settings.threads or os.cpu_count() or 1)
    torch.manual_seed(settings.seed)
    device, data, recipe = join_group().device, Dataset(settings.data), resolve(settings)
    precision = fast_precision(device)
    predictor, inputs, name = None, dict[str, str](), "true-vpn"
    if recipe.on == "predictions":
        predictor, predictor_card = load_any(settings.views, VIEW_ARCHITECTURES)
        inputs = {settings.views.name: predictor_card.sha256}
        name = "vpn" if settings.views.stem == "vpt-tob" else f"{settings.views.stem}-vpn"
    to = settings.to or Path("runs", f"{name}.safetensors")
    workspace = settings.workspace or Path("runs", to.stem)
    views = Views(data, predictor, device)
    network = Vpn(recipe.network).to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.Adam(network.parameters(), recipe.rate, fused=True)

    checkpoint = workspace / "checkpoint.pt"
    identity = {
        "recipe": asdict(replace(recipe, images=0 if recipe.stream else recipe.images)),
        "data": data.hash,
        "views": inputs,
    }
    seen, trained, best, best_measures = 0, 0.0, math.inf, dict[str, float]()  # images learnt from, seconds
    if settings.resume and checkpoint.exists():
        saved = torch.load(checkpoint, map_location=device, weights_only=True)
        if saved["identity"] != identity:
            print(f"{checkpoint} is of another recipe, training set or predictor: choose another --workspace, or --no-resume")
            return 1
        network.load_state_dict(saved["network"])
        optimizer.load_state_dict(saved["optimizer"])
        seen, trained, best, best_measures = saved["seen"], saved["trained"], saved["best"], saved["best_measures"]
        print(f"going on after {seen:,} images, {trained / 60:.1f} minutes", flush=True)
    board = Board(workspace, seen)

    held_views, held_caught = views.gather("validation", recipe.held, recipe.from_start, settings.seed)
    how = "a stream of" if recipe.stream else "a fixed set of"
    what = "true views" if predictor is None else f"predictions of {settings.views}"
    print(f"{how} {recipe.images:,} {what}, each {recipe.epochs} times; {len(held_caught):,} to validate", flush=True)
    print(f"caught in {held_caught.mean():.1%} of the views to validate", flush=True)

    def progress() -> float:
        return trained / (60 * settings.minutes) if settings.minutes else seen / (recipe.images * recipe.epochs)

    def write_checkpoint() -> None:
        state = {"identity": identity, "network": network.state_dict(), "optimizer": optimizer.state_dict()}
        counts = {"seen": seen, "trained": trained, "best": best, "best_measures": best_measures}
        torch.save({**state, **counts}, checkpoint.with_suffix(".partial"))
        os.replace(checkpoint.with_suffix(".partial"), checkpoint)

    def save_weights() -> None:
        card = card_of(network)
        card.preset, card.commit, card.metrics, card.inputs = settings.preset, source_commit(), best_measures, inputs
        card.data = {key: data.manifest[key] for key in ("hash", "episodes", "hiders", "seekers", "layouts", "horizons")}
        run = {"images seen": seen, "minutes": trained / 60, "device": str(device), "seed": settings.seed}
        card.training = {**asdict(recipe), **run}
        card.training.pop("network")
        card.notes = vpn_notes_of(recipe)
        save(network, to, card)

    stream = (streamed if recipe.stream else repeated)(views, recipe, settings.seed, seen)
    generator = np.random.default_rng([settings.seed, seen, 2])
    loss_sum, since, clock = torch.zeros((), device=device), 0, time.monotonic()  # since the last report
    done = progress()
    while done < 1.0:
        shown, truth = next(stream)
        pixels = torch.rot90(in_unit_range(shown, precision), int(generator.integers(4)), (2, 3))  # the whole batch in one call
        if recipe.symmetries == 8 and generator.random() < 0.5:
            pixels = pixels.flip(3)
        for group in optimizer.param_groups:
            group["lr"] = recipe.rate * rate_factor(recipe, done)
        with torch.autocast(device.type, precision, enabled=precision != torch.float32):
            logits = network(pixels.contiguous(memory_format=torch.channels_last))
        loss = functional.binary_cross_entropy_with_logits(logits.float(), truth)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        loss_sum += loss.detach() * len(truth)
        seen, since = seen + len(truth), since + len(truth)
        trained, clock = trained + time.monotonic() - clock, time.monotonic()
        done = progress()
        if since < settings.report_every and done < 1.0:
            continue

        scores = judge(network, held_views)
        measures = {
            "loss": float(np.logaddexp(0.0, np.where(held_caught, -scores, scores)).mean()),
            "accuracy": accuracy(scores > 0, held_caught),
            "balanced accuracy": balanced_accuracy(scores > 0, held_caught),
            "AUROC": area_under_roc(scores, held_caught),
            "majority class": float(max(held_caught.mean(), 1 - held_caught.mean())),
        }
        better = measures["loss"] < best
        if better:
            best, best_measures = measures["loss"], measures
            save_weights()
        write_checkpoint()
        learnt, left = loss_sum.item() / since, trained * (1 / max(done, 1e-9) - 1) / 60
        board.curves({**{f"validation/{key}": value for key, value in measures.items()}, "training/loss": learnt}, seen)
        parts = "  ".join(f"{key} {value:.4f}" for key, value in measures.items())
        print(
            f"{100 * done:5.1f} %  {seen:>9,} images  {max(left, 0):4.1f} min left  loss {learnt:.4f}"
            f"  validation: {parts}{'  * saved' if better else ''}",
            flush=True,
        )
        loss_sum, since, clock = torch.zeros((), device=device), 0, time.monotonic()
    board.close()
    print(f"best validation: {best_measures}; weights in {to}")
    return 0
