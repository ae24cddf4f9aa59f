"""The stages of a reproduction, in order: each one `vantage` command with its products.

In arguments and products `@` stands for the reproduction's folder, so that a stage is the same wherever it is made.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from learning.reproduce.presets import VIEW_MODELS, Group, Kind, Model, Preset

EXPERIMENTS = Path("docs/experiments")
"""Committed results of levers that were tried."""


@dataclass(frozen=True)
class Stage:
    """One command.

    Attributes:
        name: of the stage, its log and its stamp.
        arguments: what follows `vantage`; decides, with the products of `needs`, whether the stage has to run again.
        aside: more arguments, which change how fast it runs but not what is made.
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
        compiler: a C++ compiler is there, which `--compile` needs on a CPU.
    """

    cores: int
    gpu: bool
    compiler: bool

    @classmethod
    def here(cls) -> Machine:
        import os

        import torch

        return cls(os.cpu_count() or 1, torch.cuda.is_available(), bool(shutil.which("c++") or shutil.which("g++")))

    @property
    def training(self) -> tuple[str, ...]:
        """Arguments of a training that is one of several at a time, or that has the GPU."""
        return () if self.gpu else ("--threads", "1")


SPEED: dict[str, float] = {"paper": 110.0, "whole-image": 100.0, "compact": 145.0}
"""Samples a second that a view network learns from, on one core, not compiled."""
COMPILED_GAIN = 1.3
COMPILED_FROM = 40_000
"""Samples from which compiling, a minute, pays."""


def stages_of(preset: Preset, machine: Machine) -> list[Stage]:
    """Return every stage; each comes after those it needs."""
    stages = [_gather(kind, preset.seed) for kind in (preset.main, *preset.others)]
    for group in preset.groups:
        stages += _trainings(group, preset, machine)
    trained = {
        group.name: [stage for stage in stages if stage.name.startswith(f"train {group.name}/")] for group in preset.groups
    }
    stages += _evaluations(preset, trained)
    judged = tuple(stage.name for stage in stages if stage.name.startswith("evaluate"))
    first = preset.groups[0].name
    drawn = ("figures", "--data", f"@/data/{preset.main.name}/dataset", "--weights", f"@/weights/{first}")
    needs = (f"gather {preset.main.name}", *(stage.name for stage in trained[first]), *judged)
    stages.append(
        Stage("figures", (*drawn, "--results", "@/results", "--to", "@/figures"), ("@/figures/figures.json",), needs, expected=60)
    )
    everything = tuple(stage.name for stage in stages)
    experiments = tuple(sorted(EXPERIMENTS.glob("*.json")))
    stages.append(Stage("page", ("reproduce", "page", "--of", "@"), ("@/results.md",), everything, reads=experiments, expected=2))
    return stages


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
    stages = []
    kind = group.kind or preset.main.name
    data, weights = f"@/data/{kind}/dataset", f"@/weights/{group.name}"
    for model in group.models:
        name, path = f"train {group.name}/{model}", f"{weights}/{model}.safetensors"
        products = (path, f"{weights}/{model}.json", f"{weights}/{model}.md")
        workspace = f"@/runs/{group.name}/{model}"
        drop = () if group.drop is None else ("--schedule", "steps", "--drop", f"{group.drop:g}")
        common = ("--data", data, "--samples", str(group.samples), *drop, "--to", path, "--workspace", workspace)
        compile_it = machine.gpu or (machine.compiler and group.samples >= COMPILED_FROM)
        speed = SPEED[group.networks] * (1 if model in VIEW_MODELS else 2) * (COMPILED_GAIN if compile_it else 1)
        stages.append(
            Stage(
                name,
                (*_network_of(model, group), *common),
                products,
                (f"gather {kind}",),
                aside=(*machine.training, *(("--compile",) if compile_it else ())),
                scratch=(workspace,),
                alone=machine.gpu,
                expected=20 + group.samples / speed + (60 if compile_it else 0),
            )
        )
        if model in VIEW_MODELS:
            stages.append(_vpn(group, model, data, weights, name, machine))
    return stages


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


def _vpn(group: Group, model: Model, data: str, weights: str, views: str, machine: Machine) -> Stage:
    stem = vpn_stem(model)
    size = () if group.vpn is None else ("--images", str(group.vpn[0]), "--epochs", str(group.vpn[1]))
    images, epochs = group.vpn or ((16_000, 12) if group.networks == "compact" else (2_000, 100))
    preset = "compact" if group.networks == "compact" else "paper"
    what = ("--views", f"{weights}/{model}.safetensors", "--data", data, "--preset", preset, *size)
    return Stage(
        f"train {group.name}/{stem}",
        ("train", "vpn", *what, "--to", f"{weights}/{stem}.safetensors"),
        (f"{weights}/{stem}.safetensors", f"{weights}/{stem}.json", f"{weights}/{stem}.md"),
        (views,),
        aside=machine.training,
        alone=machine.gpu,
        expected=15 + images * 1.2 / 400 + images * epochs / 1500,
    )


def methods_of(group: Group) -> tuple[str, ...]:
    """Return the methods that a group's weights serve: its models, and the caught head where VPT-TOB has one."""
    head = ("caught-head",) if group.networks == "compact" and "vpt-tob" in group.models else ()
    return (*group.models, *head)


def _evaluations(preset: Preset, trained: dict[str, list[Stage]]) -> list[Stage]:
    stages = []
    first = preset.groups[0]
    horizons = tuple(map(str, preset.horizons))

    def accuracy(name: str, group: Group, kind: str, examples: int, horizons: tuple[str, ...], oracle: int) -> Stage:
        asked = ("--data", f"@/data/{kind}/dataset", "--weights", f"@/weights/{group.name}", "--methods", *methods_of(group))
        size = ("--samples", str(examples), "--horizons", *horizons, "--oracle", str(oracle))
        cost = examples * len(horizons) * (0.0007 * len(methods_of(group)) + 0.0005 * oracle)
        return Stage(
            f"evaluate {name}",
            ("evaluate", *asked, *size, "--to", f"@/results/{name}"),
            (f"@/results/{name}.json", f"@/results/{name}.md"),
            (f"gather {kind}", *(stage.name for stage in trained[group.name])),
            expected=15 + cost,
        )

    main = preset.main.name
    stages.append(accuracy("accuracy", first, main, preset.examples[-1], horizons, preset.oracle))
    for examples in preset.examples[:-1]:
        stages.append(accuracy(f"accuracy-{examples}", first, main, examples, horizons, preset.oracle))
    for kind in preset.others:
        stages.append(accuracy(f"accuracy-{kind.name}", first, kind.name, preset.examples[0], (str(kind.steps),), preset.oracle))
    for group in preset.groups[1:]:
        longest = next((str(kind.steps) for kind in preset.others if kind.name == group.kind), str(preset.main.steps))
        own_horizons = (longest,) if group.kind else horizons
        stages.append(accuracy(f"accuracy-of-{group.name}", group, group.kind or main, preset.examples[-1], own_horizons, 0))
    for group in preset.groups:
        if group.maps:
            stages.append(_maps(group, preset, trained[group.name]))
    return stages


def _maps(group: Group, preset: Preset, trained: list[Stage]) -> Stage:
    name = "maps" if group is preset.groups[0] else f"maps-of-{group.name}"
    asked = ("--weights", f"@/weights/{group.name}", "--methods", *methods_of(group), "--starts", str(preset.starts))
    where = ("--seeker", preset.main.seeker, "--layout", preset.main.layout, "--seed", "1000000")
    views = sum(model in VIEW_MODELS for model in group.models)
    return Stage(
        f"evaluate {name}",
        ("evaluate", "maps", *asked, "--horizons", *map(str, preset.map_horizons), *where, "--to", f"@/results/{name}"),
        (f"@/results/{name}.json", f"@/results/{name}.md", f"@/results/{name}.npz"),
        tuple(stage.name for stage in trained),
        expected=20 + preset.starts * (3 + 2 * views),
    )
