"""`vantage train vpn`: learn to judge predicted seeker views (paper, Value Prediction Network). Reads from top to bottom."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from learning.dataset import Dataset, Samples, prefetch
from learning.measures import accuracy, area_under_roc, balanced_accuracy
from learning.splits import Split
from vantage.log import source_commit
from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.vpt_tob import VptTob
from vantage.networks.weights import card_of, fast_device, fast_precision, load, save


@dataclass(frozen=True)
class Recipe:
    """How to train. The defaults are the paper's.

    Attributes:
        images: predicted views to learn from; a fifth as many to validate.
        epochs: how often each is seen.
        schedule: `steps` multiplies the learning rate by `drop` at 20 % and 50 % of the progress; `cosine` ends at zero.
        symmetries: 4 = quarter turns (the paper), 8 = flips, too.
        from_start: share of samples with t0 = 0.
        on: `predictions` of VPT-TOB, or `true` views (an ablation).
    """

    network: VpnSettings = field(default_factory=VpnSettings)
    images: int = 2000
    epochs: int = 100
    batch: int = 256
    rate: float = 5e-4
    schedule: Literal["steps", "cosine"] = "steps"
    drop: float = 0.9
    symmetries: int = 4
    from_start: float = 0.5
    on: Literal["predictions", "true"] = "predictions"


PRESETS: dict[str, Recipe] = {
    "paper": Recipe(),
    "compact": Recipe(images=16_000, epochs=12, batch=64, rate=1e-3, schedule="cosine", symmetries=8),
}


@dataclass(frozen=True)
class TrainVpnSettings:
    """Learn to judge the views that VPT-TOB predicts: is the hider caught?

    Example: vantage train vpn --data dataset/ --vpt-tob weights/vpt-tob.safetensors --preset compact
    """

    data: Path = Path("dataset")
    """The training set."""
    vpt_tob: Path = Path("weights/vpt-tob.safetensors")
    """Weights whose predictions it learns from."""
    to: Path = Path("weights/vpn.safetensors")
    """Where the weights go; the model card lies beside them."""
    preset: Literal["paper", "compact"] = "paper"
    """`paper`: the paper's recipe. `compact`: more images, fewer epochs."""
    images: int | None = None
    """Images to learn from, instead of the preset's number."""
    epochs: int | None = None
    """Epochs, instead of the preset's number."""
    on: Literal["predictions", "true"] | None = None
    """Learn from predicted or from true views, instead of what the preset says."""
    threads: int = 0
    """CPU threads; 0 = all cores."""
    seed: int = 1


def rate_factor(recipe: Recipe, progress: float) -> float:
    """Return the factor of the learning rate at this progress, 0..1."""
    if recipe.schedule == "cosine":
        return max(0.5 * (1.0 + math.cos(math.pi * progress)), 1e-3)
    return recipe.drop ** sum(progress >= moment for moment in (0.20, 0.50))


def pixels_of(views: NDArray[np.uint8], device: torch.device, precision: torch.dtype) -> Tensor:
    """uint8 [B, 128, 128, C] -> [B, C, 128, 128] in 0 .. 1, channels last in memory."""
    return torch.from_numpy(views).to(device).permute(0, 3, 1, 2).to(precision) * (1 / 255)


@torch.inference_mode()
def predict_views(network: VptTob, data: Dataset, samples: Samples, device: torch.device, size: int = 64) -> Iterator[Tensor]:
    """Yield the views [B, 3, 128, 128] that VPT-TOB predicts for samples, batch by batch."""
    precision = fast_precision(device)
    for batch in prefetch(lambda: data.batches(samples, size)):
        with torch.autocast(device.type, precision, enabled=precision != torch.float32):
            yield network(pixels_of(batch.inputs, device, precision))


def gather_views(
    recipe: Recipe, network: VptTob | None, data: Dataset, split: Split, count: int, device: torch.device, seed: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return views uint8 [count, 128, 128, 3], predicted or true, and whether the hider is caught in them [count]."""
    samples = data.draw(split, count, np.random.default_rng([seed, count]), recipe.from_start, symmetries=1)
    if network is None:
        return np.concatenate([batch.targets for batch in data.batches(samples, 256)]), samples.caught
    views = np.empty((count, 128, 128, 3), np.uint8)
    at, told = 0, time.monotonic()
    for predicted in predict_views(network, data, samples, device):
        views[at : at + len(predicted)] = predicted.float().mul(255).round().byte().permute(0, 2, 3, 1).cpu().numpy()
        at += len(predicted)
        if time.monotonic() - told > 10:
            told = time.monotonic()
            print(f"predicting {split} views: {at:,} of {count:,}", flush=True)
    return views, samples.caught


@torch.inference_mode()
def judge_views(network: Vpn, views: NDArray[np.uint8], device: torch.device, size: int = 256) -> NDArray[np.float32]:
    """Return the logits of "caught" [N] for views uint8 [N, 128, 128, 3]."""
    network.eval()
    parts = [network(pixels_of(views[at : at + size], device, torch.float32)).cpu() for at in range(0, len(views), size)]
    return torch.cat(parts).numpy()


def main(settings: TrainVpnSettings) -> int:
    """Train; returns the exit code."""
    torch.set_num_threads(settings.threads or os.cpu_count() or 1)
    torch.manual_seed(settings.seed)
    device, data = fast_device(), Dataset(settings.data)
    precision = fast_precision(device)
    changed = {name: value for name in ("images", "epochs", "on") if (value := getattr(settings, name)) is not None}
    recipe = replace(PRESETS[settings.preset], **changed)

    predictor, inputs = None, {}
    if recipe.on == "predictions":
        predictor, predictor_card = load(settings.vpt_tob, VptTob)
        predictor = predictor.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        inputs = {settings.vpt_tob.name: predictor_card.sha256}
    views, caught = gather_views(recipe, predictor, data, "train", recipe.images, device, settings.seed)
    held_views, held_caught = gather_views(recipe, predictor, data, "validation", recipe.images // 5, device, settings.seed)
    print(f"{recipe.images:,} {recipe.on}, caught in {caught.mean():.1%} (validation: {held_caught.mean():.1%})", flush=True)

    network = Vpn(recipe.network).to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.Adam(network.parameters(), recipe.rate, fused=True)
    generator = np.random.default_rng(settings.seed)
    best, started = math.inf, time.monotonic()
    for epoch in range(recipe.epochs):
        network.train()
        order, total = generator.permutation(len(views)), 0.0
        for at in range(0, len(order), recipe.batch):
            chosen = order[at : at + recipe.batch]
            pixels = pixels_of(views[chosen], device, precision)
            pixels = torch.rot90(pixels, int(generator.integers(4)), (2, 3))  # the whole batch: as good, and in one call
            if recipe.symmetries == 8 and generator.random() < 0.5:
                pixels = pixels.flip(3)
            for group in optimizer.param_groups:
                group["lr"] = recipe.rate * rate_factor(recipe, (epoch + at / len(order)) / recipe.epochs)
            with torch.autocast(device.type, precision, enabled=precision != torch.float32):
                logits = network(pixels.contiguous(memory_format=torch.channels_last))
            truth = torch.from_numpy(caught[chosen]).to(device).float()
            loss = functional.binary_cross_entropy_with_logits(logits.float(), truth)
            loss.backward()
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
            total += loss.item() * len(chosen)

        scores = judge_views(network, held_views, device)
        held_loss = float(np.logaddexp(0.0, np.where(held_caught, -scores, scores)).mean())
        better = held_loss < best
        left = (time.monotonic() - started) / (epoch + 1) * (recipe.epochs - epoch - 1)
        measures = {
            "loss": held_loss,
            "accuracy": accuracy(scores > 0, held_caught),
            "balanced accuracy": balanced_accuracy(scores > 0, held_caught),
            "AUROC": area_under_roc(scores, held_caught),
            "majority class": float(max(held_caught.mean(), 1 - held_caught.mean())),
        }
        parts = "  ".join(f"{name} {value:.4f}" for name, value in measures.items())
        print(
            f"epoch {epoch + 1:>3} of {recipe.epochs}  {left / 60:4.1f} min left  loss {total / len(views):.4f}"
            f"  validation: {parts}{'  * saved' if better else ''}",
            flush=True,
        )
        if better:
            best = held_loss
            card = card_of(network)
            card.preset, card.commit, card.metrics, card.inputs = settings.preset, source_commit(), measures, inputs
            card.data = {key: data.manifest[key] for key in ("hash", "episodes", "hiders", "seekers", "layouts", "horizons")}
            card.data["caught share of the images"] = float(caught.mean())
            card.training = {**asdict(recipe), "epochs seen": epoch + 1, "device": str(device), "seed": settings.seed}
            card.training.pop("network")
            if settings.preset != "paper":
                card.notes = ["Not the paper's recipe: more images, fewer epochs, cosine schedule, flips beside quarter turns."]
            save(network, settings.to, card)
    print(f"weights in {settings.to}")
    return 0
