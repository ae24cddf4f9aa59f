"""`vantage train vpt-tob`: learn to predict the seeker's view (paper, VPT-TOB Network). Reads from top to bottom."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from learning.dataset import Batch, Dataset, prefetch
from learning.group import Group, join_group
from learning.measures import area_under_roc
from learning.panel import draw_panel
from learning.recipe import PRESETS, Recipe, notes_of, rate_factor
from vantage.log import source_commit
from vantage.networks.vpt_tob import VptTob
from vantage.networks.weights import ModelCard, card_of, fast_precision, load, save


@dataclass(frozen=True)
class TrainVptTobSettings:
    """Learn to predict the seeker's view from the hider's view and its planned path.

    Example: vantage train vpt-tob --data dataset/ --preset compact --minutes 40
    """

    data: Path = Path("dataset")
    """The training set."""
    to: Path = Path("weights/vpt-tob.safetensors")
    """Where the weights go; the model card lies beside them. The checkpoint and the pictures go to runs/."""
    preset: Literal["paper", "compact"] = "paper"
    """`paper`: the paper's network and recipe. `compact`: a smaller network and a recipe for an hour on two CPU cores."""
    start: Path | None = None
    """Begin with these weights (of the same network), not from scratch; the model card names them."""
    minutes: float | None = None
    """Train for this long instead of a number of samples."""
    samples: int | None = None
    """Train on so many samples instead of the preset's number."""
    batch: int | None = None
    """Batch size, instead of the preset's."""
    disc_weight: float | None = None
    """Weight of the robots' pixels, instead of the preset's."""
    judge_weight: float | None = None
    """Weight of the judge's loss, instead of the preset's."""
    head_weight: float | None = None
    """Weight of the caught head's loss, instead of the preset's."""
    workspace: Path = Path("runs/vpt-tob")
    """Folder of the checkpoint and of the pictures of predictions."""
    resume: bool = True
    """Go on from the checkpoint, if the workspace holds one."""
    report_every: int = 16_384
    """Samples between validations."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints."""
    threads: int = 0
    """CPU threads; 0 = all cores."""
    compile: bool = False
    """Compile the network (30 % faster; takes a minute, and a C++ compiler on a CPU)."""
    seed: int = 1


def resolve(settings: TrainVptTobSettings) -> Recipe:
    """Return the preset with what the command line changes."""
    names = ("samples", "batch", "disc_weight", "judge_weight", "head_weight")
    changed = {name: value for name in names if (value := getattr(settings, name)) is not None}
    recipe = replace(PRESETS[settings.preset], **changed)
    return replace(recipe, network=replace(recipe.network, caught_head=recipe.head_weight > 0))


class Judge(nn.Module):
    """Reads a predicted view while it is being learnt: is the hider caught in it? A small and quick VPN."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            *(nn.Conv2d(3, 16, 4, 4), nn.ReLU(), nn.Conv2d(16, 32, 3, 2, 1), nn.ReLU()),
            *(nn.Conv2d(32, 32, 3, 2, 1), nn.ReLU(), nn.Flatten(), nn.Linear(32 * 8 * 8, 64), nn.ReLU(), nn.Linear(64, 1)),
        )

    def forward(self, views: Tensor) -> Tensor:  # [B, 3, 128, 128] -> [B]
        return self.layers(views).squeeze(1)


class Trainer:
    """Networks, optimiser and losses: all that a checkpoint holds."""

    def __init__(self, recipe: Recipe, group: Group, compiled: bool, seed: int) -> None:
        torch.manual_seed(seed)
        self.recipe, self.group, self.device = recipe, group, group.device
        device, self.precision = group.device, fast_precision(group.device)
        self.network = VptTob(recipe.network).to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.judge = Judge().to(device, memory_format=torch.channels_last) if recipe.judge_weight else None  # type: ignore[call-overload]
        self.parameters = [*self.network.parameters(), *(self.judge.parameters() if self.judge else ())]
        self.optimizer = torch.optim.Adam(self.parameters, recipe.rate, fused=True)
        self.forward_in_training = torch.compile(self.forward) if compiled else self.forward

    def forward(self, inputs: Tensor, targets: Tensor, discs: Tensor, caught: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss, and by name: the predicted views [B, 3, 128, 128], their mse, the logits of head and judge [B].

        Args:
            inputs: uint8 [B, 128, 128, 7]; targets: uint8 [B, 128, 128, 3]; discs: bool [B, 128, 128]; caught: float [B].
        """
        pixels = inputs.permute(0, 3, 1, 2).to(self.precision) * (1 / 255)
        with torch.autocast(self.device.type, self.precision, enabled=self.precision != torch.float32):
            views, head = self.network.forward_with_head(pixels)
            verdict = self.judge(views) if self.judge else None
        error = (views.float() - targets.permute(0, 3, 1, 2).float() * (1 / 255)).square().mean(dim=1)  # [B, 128, 128]
        found = {"views": views, "mse": error.mean()}
        loss = (
            (error * (1.0 + (self.recipe.disc_weight - 1.0) * discs)).mean() if self.recipe.disc_weight != 1.0 else error.mean()
        )
        for name, logit, weight in (("head", head, self.recipe.head_weight), ("judge", verdict, self.recipe.judge_weight)):
            if logit is not None:
                found[name] = logit.float()
                loss = loss + weight * functional.binary_cross_entropy_with_logits(logit.float(), caught)
        return loss, found

    def tensors(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return what `forward` takes."""
        arrays = (batch.inputs, batch.targets, batch.discs, batch.caught.astype(np.float32))
        inputs, targets, discs, caught = (torch.from_numpy(array).to(self.device, non_blocking=True) for array in arrays)
        return inputs, targets, discs, caught

    def learn(self, batch: Batch, factor: float) -> Tensor:
        """One step of the optimiser; returns the loss."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.recipe.rate * factor
        loss, _ = self.forward_in_training(*self.tensors(batch))
        loss.backward()
        self.group.average(self.parameters)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        return loss.detach()

    def validate(self, batches: Iterator[Batch]) -> tuple[dict[str, float], tuple[Batch, np.ndarray]]:
        """Return the mean loss and what else can be said, and the first batch with its predicted views [B, 128, 128, 3]."""
        modules = [self.network, *([self.judge] if self.judge else [])]
        for module in modules:
            module.eval()
        total, count, first = {"loss": 0.0, "mse": 0.0}, 0, None
        logits: dict[str, list[Tensor]] = {"head": [], "judge": []}
        caught = []
        with torch.inference_mode():
            for batch in batches:
                loss, found = self.forward(*self.tensors(batch))
                total["loss"] += loss.item() * len(batch.caught)
                total["mse"] += found["mse"].item() * len(batch.caught)
                count += len(batch.caught)
                caught.append(batch.caught)
                for name, values in logits.items():
                    if name in found:
                        values.append(found[name].cpu())
                if first is None:
                    first = batch, found["views"].float().mul(255).round().byte().permute(0, 2, 3, 1).cpu().numpy()
        for module in modules:
            module.train()
        measures = {name: value / count for name, value in total.items()}
        truth = np.concatenate(caught)
        for name, values in logits.items():
            if values:
                scores = torch.cat(values).numpy()
                measures[f"{name} accuracy"] = float(((scores > 0) == truth).mean())
                measures[f"{name} AUROC"] = area_under_roc(scores, truth)
        assert first is not None
        return measures, first

    def state(self) -> dict[str, Any]:
        judge = self.judge.state_dict() if self.judge else None
        return {"network": self.network.state_dict(), "judge": judge, "optimizer": self.optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        if self.judge:
            self.judge.load_state_dict(state["judge"])
        self.optimizer.load_state_dict(state["optimizer"])


def main(settings: TrainVptTobSettings) -> int:
    """Train; returns the exit code."""
    group = join_group()
    torch.set_num_threads(settings.threads or max(1, (os.cpu_count() or 1) // group.size))
    recipe, data = resolve(settings), Dataset(settings.data)
    trainer = Trainer(recipe, group, settings.compile, settings.seed)
    size = sum(parameter.numel() for parameter in trainer.network.parameters())
    say = partial(print, flush=True) if group.rank == 0 else lambda *_: None
    say(f"VPT-TOB `{settings.preset}`, {size:,} parameters, {group.size} x {group.device}, {trainer.precision}")
    say(f"{settings.data}: episodes {data.manifest['episodes']}, by hider {data.manifest['hiders']}")

    begun_with: dict[str, str] = {}
    if settings.start:
        earlier, earlier_card = load(settings.start, VptTob)
        if earlier.settings != trainer.network.settings:
            say(f"{settings.start} holds another network than the preset `{settings.preset}`: {earlier.settings}")
            return 1
        trainer.network.load_state_dict(earlier.state_dict())
        begun_with = {settings.start.name: earlier_card.sha256}

    checkpoint = settings.workspace / "checkpoint.pt"
    identity = {"recipe": asdict(replace(recipe, samples=0)), "data": data.hash}
    seen, trained, best, best_measures = 0, 0.0, math.inf, dict[str, float]()  # samples, seconds
    if settings.resume and checkpoint.exists():
        saved = torch.load(checkpoint, map_location=group.device, weights_only=True)
        if saved["identity"] != identity:
            say(f"{checkpoint} is of another recipe or training set: choose another --workspace, or --no-resume")
            return 1
        trainer.restore(saved["trainer"])
        seen, trained, best, best_measures = saved["seen"], saved["trained"], saved["best"], saved["best_measures"]
        say(f"going on after {seen:,} samples, {trained / 60:.1f} minutes")

    validation = data.draw("validation", 1024, np.random.default_rng(0), recipe.from_start, symmetries=1)

    def batches() -> Iterator[Batch]:
        number = seen // recipe.batch + group.rank
        while True:  # a batch depends on its number alone, so that a resumed run goes on as if never stopped
            generator = np.random.default_rng([settings.seed, number])
            yield data.render(data.draw("train", recipe.batch, generator, recipe.from_start, symmetries=recipe.symmetries))
            number += group.size

    def progress() -> float:
        return group.from_first(trained / (60 * settings.minutes) if settings.minutes else seen / recipe.samples)

    def write_checkpoint() -> None:
        settings.workspace.mkdir(parents=True, exist_ok=True)
        state = {"identity": identity, "trainer": trainer.state(), "seen": seen, "trained": trained}
        partial_path = checkpoint.with_suffix(".partial")
        torch.save({**state, "best": best, "best_measures": best_measures}, partial_path)
        os.replace(partial_path, checkpoint)

    def make_card(measures: dict[str, float]) -> ModelCard:
        card = card_of(trainer.network)
        card.preset, card.commit, card.metrics = settings.preset, source_commit(), measures
        card.data = {key: data.manifest[key] for key in ("hash", "episodes", "hiders", "seekers", "layouts", "horizons")}
        card.training = {
            **asdict(recipe),
            "samples": seen,
            "minutes": trained / 60,
            "device": str(group.device),
            "seed": settings.seed,
        }
        card.training.pop("network")
        card.notes, card.inputs = notes_of(settings.preset, recipe), begun_with
        return card

    stream = prefetch(batches)
    loss, steps = torch.zeros((), device=group.device), 0  # summed since the last report
    reported, reported_at, written_at, clock = seen, trained, trained, time.monotonic()
    done = progress()
    while done < 1.0:
        loss += trainer.learn(next(stream), rate_factor(recipe, done))
        steps += 1
        seen += recipe.batch * group.size
        trained, clock = trained + time.monotonic() - clock, time.monotonic()
        done = progress()
        if group.rank == 0 and (seen - reported >= settings.report_every or done >= 1.0):
            measures, (batch, views) = trainer.validate(data.batches(validation, 64))
            draw_panel(settings.workspace / "latest.png", batch, views)
            better = measures["loss"] < best
            if better:
                best, best_measures = measures["loss"], measures
                save(trainer.network, settings.to, make_card(measures))
            speed, left = (seen - reported) / max(trained - reported_at, 1e-9), trained * (1 / max(done, 1e-9) - 1) / 60
            parts = "  ".join(f"{name} {value:.4f}" for name, value in measures.items())
            say(
                f"{100 * done:5.1f} %  {seen:>9,} samples  {speed:4.0f}/s  {max(left, 0):4.0f} min left"
                f"  loss {loss.item() / steps:.4f}  validation: {parts}{'  * saved' if better else ''}"
            )
            loss.zero_()
            steps, reported, reported_at, clock = 0, seen, trained, time.monotonic()
        if group.rank == 0 and (trained - written_at >= 60 * settings.checkpoint_minutes or done >= 1.0):
            write_checkpoint()
            written_at, clock = trained, time.monotonic()
    say(f"best validation: {best_measures}; weights in {settings.to}")
    group.leave()
    return 0


if __name__ == "__main__":  # for torchrun
    import sys

    import tyro

    sys.exit(main(tyro.cli(TrainVptTobSettings)))
