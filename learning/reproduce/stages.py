"""The stages of a reproduction, in order: each one `vantage` command with its products.

In arguments and products `@` stands for the reproduction's folder, so that a stage is the same wherever it is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from learning.provenance import hardware
from learning.reproduce.presets import VIEW_MODELS, Group, Kind, Model, Preset

EXPERIMENTS = Path("docs/experiments")
"""Committed results of levers that were tried."""


@dataclass(frozen=True)
class Stage:
    """One command.

    Attributes:
        name: of the stage, its log and its stamp.
        arguments: what follows `vantage`; decides, with the products of `needs`, whether the stage has to run again.
        aside: more arguments, which do not change what is made.
        needs: names of the stages whose products go in.
        products: files it leaves.
        scratch: folders that hold its half-done work; emptied where they belong to other arguments.
        whole: folders that belong to the products, where the files named are not all of it.
        reads: files outside the folder that go in.
        alone: uses all cores or the GPU, so nothing runs beside it.
        expected: seconds on two free cores, roughly.
    """

    name: str
    arguments: tuple[str, ...]
    products: tuple[str, ...]
    needs: tuple[str, ...] = ()
    aside: tuple[str, ...] = ()
    scratch: tuple[str, ...] = ()
    whole: tuple[str, ...] = ()
    reads: tuple[Path, ...] = ()
    alone: bool = True
    expected: float = 10.0


@dataclass(frozen=True)
class Machine:
    """What the stages are planned for.

    Attributes:
        cores: CPU cores.
        gpu: there is one, so trainings take turns on it.
    """

    cores: int
    gpu: bool

    @classmethod
    def here(cls) -> Machine:
        import torch

        return cls(hardware()["cores"], torch.cuda.is_available())

    @property
    def training(self) -> tuple[str, ...]:
        """Arguments of a training that is one of several at a time, or that has the GPU."""
        return () if self.gpu else ("--threads", "1")


SPEED: dict[str, float] = {"paper": 110.0, "whole-image": 100.0, "compact": 145.0}
"""Samples a second that a view network learns from, on one core, not compiled (longer trainings are)."""


def stages_of(name: str, preset: Preset, machine: Machine, given: Sequence[Path] = ()) -> list[Stage]:
    """Return every stage of a preset, called `name`; each comes after those it needs.

    Args:
        given: weights that lie in the reproduction's folder already and are not trained: GROUP/STEM.safetensors.
    """
    made = {group.name: _trainings(group, preset, machine) for group in preset.groups}
    gifts = {f"train {path.parent.name}/{path.stem}": path for path in given}
    made = {group: [_without(stage, gifts) for stage in stages if stage.name not in gifts] for group, stages in made.items()}
    trainings = [stage for stages in made.values() for stage in stages]
    needed = {need for stage in trainings for need in stage.needs}
    kinds = dict.fromkeys((preset.main, *preset.others, *(group.kind for group in preset.groups if group.kind)))
    gathers = [_gather(kind, preset.seed) for kind in kinds]
    judged_on = {f"gather {kind.name}" for kind in (preset.main, *preset.others)}
    stages = [stage for stage in gathers if stage.name in needed | judged_on] + trainings
    inputs = {
        group.name: Inputs(
            tuple(stage.name for stage in made[group.name]),
            tuple(path for path in given if path.parent.name == group.name),
        )
        for group in preset.groups
    }
    stages += _evaluations(preset, inputs)
    judged = tuple(stage.name for stage in stages if stage.name.startswith("evaluate"))
    first = preset.groups[0].name
    drawn = ("figures", "--force", "--data", f"@/data/{preset.main.name}/dataset", "--weights", f"@/weights/{first}")
    needs = (f"gather {preset.main.name}", *inputs[first].trained, *judged)
    figures = (*drawn, "--results", "@/results", "--to", "@/figures")
    drawing = Stage("figures", figures, ("@/figures/figures.json",), needs, reads=inputs[first].given, expected=60)
    stages.append(replace(drawing, whole=("@/figures",)))
    everything = tuple(stage.name for stage in stages)
    experiments = tuple(sorted(EXPERIMENTS.glob("*.json")))
    page = ("reproduce", "page", "--of", "@", "--preset", name)
    stages.append(
        Stage("page", page, ("@/results.md", "@/results/made.json"), everything, reads=(*experiments, *given), expected=2)
    )
    return stages


@dataclass(frozen=True)
class Inputs:
    """Where a group's weights come from: stages that train them, files that were given."""

    trained: tuple[str, ...]
    given: tuple[Path, ...]


def _without(stage: Stage, gifts: dict[str, Path]) -> Stage:
    """Return a training whose predictor's weights were given as one that reads these, not as one that needs their training."""
    needs = tuple(need for need in stage.needs if need not in gifts)
    return replace(stage, needs=needs, reads=tuple(gifts[need] for need in stage.needs if need in gifts))


def _gather(kind: Kind, seed: int) -> Stage:
    train, validation, test = kind.games
    folder = f"@/data/{kind.name}"
    what = ("--seeker", kind.seeker, "--layout", kind.layout, "--steps", str(kind.steps), "--seed", str(seed))
    sizes = ("--train", str(train), "--validation", str(validation), "--test", str(test))
    return Stage(
        f"gather {kind.name}",
        ("gather", *what, *sizes, "--to", folder),
        (f"{folder}/manifest.json", f"{folder}/dataset/manifest.json"),
        scratch=(folder,),
        whole=(f"{folder}/dataset",),
        expected=10 + sum(kind.games) * kind.steps / 200 * 0.022,
    )


def _trainings(group: Group, preset: Preset, machine: Machine) -> list[Stage]:
    if not group.samples:
        return []
    return [stage for seed in group.seeds for stage in _trainings_with(seed, group, preset, machine)]


def _trainings_with(seed: int, group: Group, preset: Preset, machine: Machine) -> list[Stage]:
    stages: list[Stage] = []
    kind = (group.kind or preset.main).name
    data, weights = f"@/data/{kind}/dataset", f"@/weights/{group.name}"
    for model in group.models:
        stem = seeded(model, seed, group)
        name, path = f"train {group.name}/{stem}", f"{weights}/{stem}.safetensors"
        products = (path, f"{weights}/{stem}.json", f"{weights}/{stem}.md")
        workspace = f"@/runs/{group.name}/{stem}"
        drop = () if group.drop is None else ("--drop", f"{group.drop:g}")
        batch = () if group.batch is None else ("--batch", str(group.batch))
        plain = ("--head-weight", "0", "--judge-weight", "0") if group.plain and model in VIEW_MODELS else ()
        size = ("--samples", str(group.samples), *batch, *drop, *plain)
        common = ("--data", data, *size, *_seed(seed), "--to", path, "--workspace", workspace)
        speed = SPEED[group.networks] * (1 if model in VIEW_MODELS else 2.5) * (1.3 if group.samples >= 100_000 else 1)
        stages.append(
            Stage(
                name,
                (*_network_of(model, group), *common),
                products,
                (f"gather {kind}",),
                aside=machine.training,
                scratch=(workspace,),
                alone=machine.gpu,
                expected=20 + group.samples / speed,
            )
        )
        if model in VIEW_MODELS:
            stages.append(_vpn(seed, group, model, kind, machine))
    if group.vpn_on_true:
        stages.append(_vpn(seed, group, "vpt-tob", kind, machine, on_true=True))
    return stages


def seeded(stem: str, seed: int, group: Group) -> str:
    """Return the file stem of a training: with its seed where the group has several."""
    return f"{stem}-seed{seed}" if len(group.seeds) > 1 else stem


def _seed(seed: int) -> tuple[str, ...]:
    return () if seed == 1 else ("--seeds", str(seed))


def _network_of(model: Model, group: Group) -> tuple[str, ...]:
    """Return the words of the command, up to the network's preset."""
    if model == "whole-image":
        return ("train", "vpt-tob", "--model", "vpt-tob", "--preset", "whole-image")
    if model in VIEW_MODELS:
        return ("train", "vpt-tob", "--model", model, "--preset", group.networks)
    return ("train", "caught", "--model", model, "--preset", group.networks)


def vpn_stem(model: Model) -> str:
    """Return the file stem of the VPN that judges a model's views."""
    return "vpn" if model == "vpt-tob" else f"{model}-vpn"


def _vpn(seed: int, group: Group, model: Model, kind: str, machine: Machine, on_true: bool = False) -> Stage:
    data, weights = f"@/data/{kind}/dataset", f"@/weights/{group.name}"
    predictor = seeded(model, seed, group)
    gathered, views = f"gather {kind}", f"train {group.name}/{predictor}"
    stem = seeded("vpn-on-true" if on_true else vpn_stem(model), seed, group)
    workspace = f"@/runs/{group.name}/{stem}"
    size = () if group.vpn is None else ("--images", str(group.vpn[0]), "--epochs", str(group.vpn[1]))
    images, epochs = group.vpn or ((200_000, 2) if group.networks == "compact" else (2_000, 100))
    preset = "compact" if group.networks == "compact" else "paper"
    true = ("--on", "true") if on_true else ()
    what = ("--views", f"{weights}/{predictor}.safetensors", "--data", data, "--preset", preset, *size, *true, *_seed(seed))
    return Stage(
        f"train {group.name}/{stem}",
        ("train", "vpn", *what, "--to", f"{weights}/{stem}.safetensors", "--workspace", workspace),
        (f"{weights}/{stem}.safetensors", f"{weights}/{stem}.json", f"{weights}/{stem}.md"),
        (gathered, views),
        aside=machine.training,
        scratch=(workspace,),
        alone=machine.gpu,
        expected=25 + images / 500 + images * epochs / 2500,
    )


def methods_of(group: Group) -> tuple[str, ...]:
    """Return the methods that a group's weights serve: its models, and the caught head where VPT-TOB has one."""
    head = ("caught-head",) if group.networks == "compact" and not group.plain and "vpt-tob" in group.models else ()
    return (*group.models, *head)


def _evaluations(preset: Preset, inputs: dict[str, Inputs]) -> list[Stage]:
    first, main = preset.groups[0], preset.main

    def accuracy(
        name: str,
        group: Group,
        kind: Kind,
        examples: tuple[int, ...],
        horizons: tuple[int, ...],
        oracle: tuple[int, int] = (0, 0),
    ) -> Stage:
        folder = f"@/data/{kind.name}/dataset"
        asked = ("--data", folder, "--weights", f"@/weights/{group.name}", "--methods", *methods_of(group))
        more = ("--ablations",) if group.vpn_on_true else ()
        size = ("--samples", *map(str, examples), "--horizons", *map(str, horizons))
        ceiling = ("--oracle", str(oracle[0]), "--oracle-samples", str(oracle[1])) if oracle[0] else ()
        cost = len(horizons) * (max(examples) * 0.001 * len(methods_of(group)) + oracle[0] * oracle[1] * 0.0016)
        return Stage(
            f"evaluate {name}",
            ("evaluate", *asked, *size, *ceiling, *more, "--to", f"@/results/{name}"),
            (f"@/results/{name}.json", f"@/results/{name}.md"),
            (f"gather {kind.name}", *inputs[group.name].trained),
            aside=("--force",),
            reads=inputs[group.name].given,
            expected=20 + cost,
        )

    stages = [accuracy("accuracy", first, main, preset.examples, preset.horizons, preset.oracle)]
    stages += [
        accuracy(f"accuracy-{kind.name}", first, kind, preset.examples[:1], (kind.steps,), preset.oracle)
        for kind in preset.others
    ]
    for group in preset.groups[1:]:
        kind = main if group.kind is None or group.kind.as_played(main) else group.kind
        horizons = preset.horizons if kind is main else (kind.steps,)
        stages.append(accuracy(f"accuracy-of-{group.name}", group, kind, preset.examples, horizons))
    return stages + [_maps(group, preset, inputs[group.name]) for group in preset.groups if group.maps]


def _maps(group: Group, preset: Preset, inputs: Inputs) -> Stage:
    name = "maps" if group is preset.groups[0] else f"maps-of-{group.name}"
    methods = methods_of(group) if group.mapped is None else group.mapped
    asked = ("--weights", f"@/weights/{group.name}", "--methods", *methods, "--starts", str(preset.starts))
    many = ("--simulations", str(preset.simulations))
    where = ("--seeker", preset.main.seeker, "--layout", preset.main.layout, "--seed", "1000000")
    views = sum(model in VIEW_MODELS for model in methods)
    return Stage(
        f"evaluate {name}",
        ("evaluate", "maps", *asked, "--horizons", *map(str, preset.map_horizons), *many, *where, "--to", f"@/results/{name}"),
        (f"@/results/{name}.json", f"@/results/{name}.md", f"@/results/{name}.npz"),
        inputs.trained,
        aside=("--force",),
        reads=inputs.given,
        expected=20 + preset.starts * (1 + 0.3 * preset.simulations + 3 * views),
    )
