"""The reproduction: what is run again and what is not, that every planned command exists, and the whole of it, very small."""

import contextlib
import io
import json
import shlex
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
import torch
import tyro

from learning import recipe
from learning.reproduce import tables
from learning.reproduce.command import lines_of, publish
from learning.reproduce.made import wall
from learning.reproduce.page import page_of
from learning.reproduce.presets import PRESETS, Preset
from learning.reproduce.runner import Progress, Runner
from learning.reproduce.stages import EXPERIMENTS, Machine, Stage, stages_of
from learning.reproduce.stamps import Stamps
from learning.reproduce.targets import Target, target_table, targets
from vantage import cli
from vantage.networks.vpt_tob import VptTobSettings

DOCS = Path(__file__).parents[2] / "docs"


class Done:
    """A process that has ended."""

    def __init__(self, code: int) -> None:
        self.code = code

    def poll(self) -> int:
        return self.code

    def terminate(self) -> None: ...
    def kill(self) -> None: ...
    def wait(self, timeout: float | None = None) -> int:
        return self.code


class Workshop:
    """Stages as functions: `make NAME TEXT INPUT...` writes TEXT and the inputs' content into @/NAME."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.ran, self.broken = folder, list[str](), set[str]()

    def launch(self, arguments: tuple[str, ...], output: IO[bytes], environment: dict[str, str]) -> Done:
        _, name, text, *inputs = arguments
        self.ran.append(name)
        output.write(b"working\n")
        if name in self.broken:
            output.write(b"something broke\n")
            return Done(3)
        (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (self.folder / name).write_text(text + "".join(Path(path).read_text() for path in inputs))
        return Done(0)

    def run(self, stages: list[Stage], have: tuple[Path, ...] = (), slots: int = 2) -> tuple[dict[str, str], list[str]]:
        """Return the states by stage, and which stages ran."""
        self.ran.clear()
        runner = Runner(stages, self.folder, slots, have, lambda progress, event: None, self.launch)
        runner.run()
        return runner.progress.state, list(self.ran)


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("learning.reproduce.runner.POLL", 0.001)


def make(name: str, text: str, *needs: str, scratch: tuple[str, ...] = ()) -> Stage:
    places = tuple(f"@/{need}" for need in needs)
    return Stage(name, ("make", name, text, *places), (f"@/{name}",), needs, scratch=scratch, alone=False)


def diamond(a: str = "a", b: str = "b", c: str = "c") -> list[Stage]:
    return [make("A", a), make("B", b, "A"), make("C", c, "A"), make("D", "d", "B", "C"), make("E", "e")]


def test_what_is_done_is_not_done_again(tmp_path: Path) -> None:
    shop = Workshop(tmp_path)
    state, ran = shop.run(diamond())
    assert set(state.values()) == {"done"} and sorted(ran) == list("ABCDE")
    assert (tmp_path / "D").read_text() == "dbaca"
    assert ran.index("A") < min(ran.index("B"), ran.index("C")) and ran.index("D") > max(ran.index("B"), ran.index("C"))
    state, ran = shop.run(diamond())
    assert set(state.values()) == {"kept"} and ran == []


@pytest.mark.parametrize(("changed", "again"), [({"a": "x"}, "ABCD"), ({"b": "x"}, "BD"), ({"c": "x"}, "CD")])
def test_a_changed_setting_reruns_what_depends_on_it_and_nothing_else(
    tmp_path: Path, changed: dict[str, str], again: str
) -> None:
    shop = Workshop(tmp_path)
    shop.run(diamond())
    _, ran = shop.run(diamond(**changed))
    assert sorted(ran) == list(again)


def test_a_product_that_is_gone_or_was_touched_is_made_again(tmp_path: Path) -> None:
    shop = Workshop(tmp_path)
    shop.run(diamond())
    (tmp_path / "B").unlink()
    assert shop.run(diamond())[1] == ["B"], "the same comes out of it, so D is still good"
    (tmp_path / "C").write_text("edited by hand")
    assert shop.run(diamond())[1] == ["C"]


def test_a_failure_stops_what_needs_it_alone_and_the_next_run_goes_on(tmp_path: Path) -> None:
    shop = Workshop(tmp_path)
    shop.broken = {"B"}
    said: list[str] = []
    runner = Runner(diamond(), tmp_path, 2, (), lambda progress, event: said.append(event), shop.launch)
    assert not runner.run()
    assert runner.progress.state == {"A": "done", "B": "failed", "C": "done", "D": "blocked", "E": "done"}
    (failure,) = [event for event in said if "FAILED" in event]
    assert "B" in failure and "exit code 3" in failure and "something broke" in failure and "B.log" in failure
    shop.broken = set()
    assert shop.run(diamond())[1] == ["B", "D"]


def test_a_command_that_leaves_no_product_has_failed(tmp_path: Path) -> None:
    runner = Runner([make("A", "a")], tmp_path, 1, (), lambda progress, event: None, lambda *_: Done(0))
    assert not runner.run()
    assert runner.progress.state == {"A": "failed"}


def test_half_done_work_is_kept_for_the_same_command_only(tmp_path: Path) -> None:
    shop = Workshop(tmp_path)
    shop.broken = {"A"}
    stage = make("A", "a", scratch=("@/runs",))
    shop.run([stage])
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs/checkpoint").write_text("half")
    shop.run([stage])
    assert (tmp_path / "runs/checkpoint").exists()
    shop.run([make("A", "other", scratch=("@/runs",))])
    assert not (tmp_path / "runs").exists()


def test_what_was_not_begun_here_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs/checkpoint").write_text("somebody's")
    Workshop(tmp_path).run([make("A", "a", scratch=("@/runs",))])
    assert (tmp_path / "runs/checkpoint").exists()


def test_given_weights_are_not_trained_and_their_change_is_noticed(tmp_path: Path) -> None:
    from learning.reproduce.command import Refusal, ReproduceSettings, given_weights

    source = tmp_path / "elsewhere"
    source.mkdir()
    for ending in ("safetensors", "json", "md"):
        (source / f"vpt-tob.{ending}").write_text("trained")
    settings = ReproduceSettings(preset="paper", given=(f"longer={source}",))
    given = given_weights(settings, tmp_path / "here")
    found = {path.relative_to(tmp_path / "here/weights").as_posix() for path in given}
    assert {name for name in found if not name.startswith("released/")} == {"longer/vpt-tob.safetensors"}
    assert {"released/vpt-tob.safetensors", "released/vpn.safetensors"} <= found, "those of this release, always"
    all_stages = {stage.name: stage for stage in stages_of("paper", PRESETS["paper"], Machine(2, False))}
    stages = {stage.name: stage for stage in stages_of("paper", PRESETS["paper"], Machine(2, False), given)}
    assert all_stages.keys() - stages.keys() == {"train longer/vpt-tob"}
    for name in ("train longer/vpn", "evaluate accuracy-of-longer", "evaluate maps-of-longer"):
        assert (
            stages[name].reads == tuple(path for path in given if path.parent.name == "longer")
            and "train longer/vpt-tob" not in stages[name].needs
        )
    for stem in ("vpn", "hazard", "hazard-attention"):
        (source / f"{stem}.safetensors").write_text("trained")
        for ending in ("json", "md"):
            (source / f"{stem}.{ending}").write_text("")
    stages = {
        s.name: s for s in stages_of("paper", PRESETS["paper"], Machine(2, False), given_weights(settings, tmp_path / "here"))
    }
    assert "gather glancing-random-200-large" not in stages, "nothing learns from it any more"
    for wrong in ("nobody=weights", f"longer={tmp_path}"):
        with pytest.raises(Refusal):
            given_weights(replace(settings, given=(wrong,)), tmp_path / "here")


def test_products_of_the_very_same_commands_are_taken_over(tmp_path: Path) -> None:
    there, here = Workshop(tmp_path / "there"), Workshop(tmp_path / "here")
    there.run(diamond())
    state, ran = here.run(diamond(b="x"), have=(there.folder,))
    assert ran == ["B", "D"]
    assert [name for name, each in state.items() if each == "taken"] == ["A", "C", "E"]
    assert (here.folder / "D").read_text() == "dxaca" and (there.folder / "D").read_text() == "dbaca"
    stamp = Stamps(here.folder).read(diamond()[0])
    assert stamp is not None and stamp.taken_from == str(there.folder)
    assert here.run(diamond(b="x"))[1] == []


def test_no_more_run_at_a_time_than_there_is_room_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    together: list[list[str]] = []
    running: list[str] = []
    lock = threading.Lock()

    class Slow(Done):
        def __init__(self, name: str) -> None:
            super().__init__(0)
            self.name, self.until = name, time.monotonic() + 0.02

        def poll(self) -> int | None:  # type: ignore[override]
            if time.monotonic() < self.until:
                return None
            with lock:
                running.remove(self.name)
            (tmp_path / self.name).write_text("")
            return 0

    def launch(arguments: tuple[str, ...], output: IO[bytes], environment: dict[str, str]) -> Slow:
        with lock:
            running.append(arguments[1])
            together.append(list(running))
        assert environment["OMP_NUM_THREADS"] == ("7" if arguments[1].startswith("alone") else "1")
        return Slow(arguments[1])

    stages = [make(f"train{number}", "") for number in range(7)]
    stages[3:3] = [replace(make(f"alone{number}", ""), alone=True) for number in range(2)]
    assert Runner(stages, tmp_path, 3, (), lambda progress, event: None, launch).run()
    assert max(map(len, together)) == 3
    assert all(len(names) == 1 for names in together if any(name.startswith("alone") for name in names))


def test_progress_says_how_far_and_how_long(tmp_path: Path) -> None:
    seen: list[tuple[int, float, list[str]]] = []

    def show(progress: Progress, event: str) -> None:
        seen.append((progress.finished, progress.left(), lines_of(progress)))

    Runner(diamond(), tmp_path, 1, (), show, Workshop(tmp_path).launch).run()
    assert [finished for finished, _, _ in seen] == sorted(finished for finished, _, _ in seen)
    assert seen[0][1] > seen[-1][1] == 0
    assert any("stage 1, A" in "".join(lines) for _, _, lines in seen)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("machine", [Machine(2, False), Machine(16, True)])
def test_every_planned_command_exists_and_all_it_reads_is_made_before(name: str, machine: Machine, tmp_path: Path) -> None:
    import importlib
    import inspect
    import typing

    stages = stages_of(name, PRESETS[name], machine)
    runner = Runner(stages, tmp_path, 1, (), lambda progress, event: None)
    assert len(runner.stages) == len(stages), "no two of one name"
    made: dict[str, str] = {}
    for stage in stages:
        assert set(stage.needs) <= set(made.values()), "each comes after those it needs"
        for argument in stage.arguments:
            released = argument == "@/weights/released"
            if argument.startswith("@/") and argument not in (*stage.products, *stage.scratch) and not released:
                makers = {by for product, by in made.items() if product.startswith(argument)}
                outputs = [product for product in stage.products if product.startswith(argument)]
                assert outputs or makers & set(stage.needs), f"{stage.name} reads {argument}, which nothing it needs makes"
        assert not set(stage.products) & set(made), stage.name
        made |= dict.fromkeys(stage.products, stage.name)
        found = cli.find(runner.arguments(stage))
        assert found is not None, stage.arguments
        command, options = found
        module, _, function = command.target.partition(":")
        main = getattr(importlib.import_module(module), function)
        (parameter,) = inspect.signature(main).parameters
        tyro.cli(typing.get_type_hints(main)[parameter], args=list(options))  # SystemExit where an option does not exist


def test_what_is_compared_has_equal_data_and_samples() -> None:
    for name, preset in PRESETS.items():
        stages = stages_of(name, preset, Machine(2, False))
        first = preset.groups[0].name
        asked = [
            stage.arguments for stage in stages if stage.name.startswith(f"train {first}/") and "--samples" in stage.arguments
        ]
        for option in ("--samples", "--data", "--preset"):
            values = {arguments[arguments.index(option) + 1] for arguments in asked} - {"whole-image"}
            assert len(values) == 1, (name, option, values)


def in_process(arguments: tuple[str, ...], output: IO[bytes], environment: dict[str, str]) -> Done:
    """Run a `vantage` command here: a dozen processes that load torch would take longer than all they do."""
    text = io.TextIOWrapper(output, write_through=True)
    try:
        with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
            found = cli.find(arguments)
            assert found is not None
            return Done(cli.run(*found))
    finally:
        text.detach()


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> Iterator[Preset]:
    """The preset `smoke` with networks of a few channels."""
    shape = VptTobSettings(width=0.25, whole_image=True, caught_head=True)
    monkeypatch.setitem(recipe.PRESETS, "compact", replace(recipe.PRESETS["compact"], network=shape))
    monkeypatch.setitem(recipe.VPN_PRESETS, "compact", replace(recipe.VPN_PRESETS["compact"], held=64, pool=64))
    narrow = replace(recipe.CAUGHT_PRESETS["compact"], encoder=(4, 4, 8, 8, 8, 8, 16, 16))
    monkeypatch.setitem(recipe.CAUGHT_PRESETS, "compact", narrow)
    threads = torch.get_num_threads()
    yield PRESETS["smoke"]
    torch.set_num_threads(threads)


def reproduce(preset: Preset, folder: Path) -> tuple[Runner, list[str]]:
    ran: list[str] = []

    def launch(arguments: tuple[str, ...], output: IO[bytes], environment: dict[str, str]) -> Done:
        ran.append(environment["VANTAGE_STAGE"])
        return in_process(arguments, output, environment)

    said: list[str] = []
    stages = stages_of("smoke", preset, Machine(2, False))
    runner = Runner(stages, folder, 1, (), lambda progress, event: said.append(event), launch)
    assert runner.run(), "\n".join(said)
    return runner, ran


def states_of_a_failing_run(preset: Preset, folder: Path) -> dict[str, str]:
    """Return the states by stage when whatever a changed preset runs again fails at once: what waits for it is blocked."""
    runner = Runner(
        stages_of("smoke", preset, Machine(2, False)), folder, 1, (), lambda progress, event: None, lambda *_: Done(1)
    )
    assert not runner.run()
    return runner.progress.state


@pytest.mark.timeout(1200)
def test_from_nothing_to_the_page(tiny: Preset, tmp_path: Path) -> None:
    folder = tmp_path / "reproduction"
    runner, ran = reproduce(tiny, folder)
    assert len(ran) == len(runner.stages)
    page = (folder / "results.md").read_text()
    figures = json.loads((folder / "figures/figures.json").read_text())["figures"]
    expected = {"training-pairs", "predicted-views", "side-by-side", "value-maps", "run", "table-1", "accuracy-over-horizon"}
    assert {Path(name).stem for name in figures} == expected | {"reliability", "table-2", "play"}
    for name in figures:
        assert f"](figures/{name})" in page
        assert 1_000 < (folder / "figures" / name).stat().st_size < 1_000_000
    made = json.loads((folder / "results/made.json").read_text())
    commands = {stage["command"] for stage in made["stages"].values()}
    for stage in runner.stages.values():
        if stage.name != "page":
            assert shlex.join(("vantage", *runner.arguments(stage))) in commands, "the command of every stage"
    for part in ("the paper, %", "76.61", "88.45", "Commit: `", "cores of", "not met", "seed", "goal-walk"):
        assert part in page, part
    accuracy = json.loads((folder / "results/accuracy.json").read_text())
    for found in accuracy["methods"].values():
        for seen in found["weights"].values():
            assert seen["sha256"][:12] in page
    of_seeds = json.loads((folder / "results/accuracy-of-drop-0.5.json").read_text())
    assert [seen["seed"] for seen in of_seeds["methods"]["hazard"]["weights"].values()] == [1, 2]
    assert "seeds 1, 2" in page and "n = 2" in page, "the spread over training seeds stands beside the interval over games"
    assert "Shown by their commands: compared/hazard" in page and "once left out the seed" not in page

    assert reproduce(tiny, folder)[1] == [], "a second run has nothing to do"
    publish(folder, tmp_path)
    published = (tmp_path / "docs/results.md").read_text()
    for name in figures:
        assert f"](figures/{name})" in published and (tmp_path / "docs/figures" / name).is_file()
    (tmp_path / "docs/results.md").unlink()
    assert cli.run(*cli.find(["reproduce", "page", "--of", str(tmp_path / "docs"), "--preset", "smoke"])) == 0  # type: ignore[misc]
    assert (tmp_path / "docs/results.md").read_text() == published, "the page needs nothing but what is published"
    assert "## A VPN that learns" in (tmp_path / "docs/results-levers.md").read_text()

    gone = folder / "weights/compared/hazard.safetensors"
    whole = gone.read_bytes()
    gone.unlink()
    assert reproduce(tiny, folder)[1] == ["train compared/hazard"], "written again from its checkpoint: all else still holds"
    assert gone.read_bytes() == whole

    again = {"evaluate maps": "failed", "figures": "blocked", "page": "blocked"}
    expected_states = {**dict.fromkeys(runner.stages, "kept"), **again}
    assert states_of_a_failing_run(replace(tiny, map_horizons=(40,)), folder) == expected_states


def test_targets_are_said_to_be_met_only_where_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [Target("one", "89.0", True, "`compared`"), Target("two", "50.0", False)]
    monkeypatch.setattr("learning.reproduce.targets.targets", lambda found, preset: rows)
    text = "\n".join(target_table(None, "quick"))  # type: ignore[arg-type]
    assert "1 of 2 met" in text
    assert "| one | 89.0 | met | `compared` |" in text and "| two | 50.0 | **not met** |  |" in text


def test_a_figure_stands_beside_the_networks_it_is_of_and_what_flatters_it(published: tables.Findings) -> None:
    """What was wrong: the first `met` of the page was of other networks than its Table I, the caveat 200 lines below."""
    rows = [row for row in targets(published, "hours") if row.wanted == "VPT-TOB + VPN, accuracy at T = 200: at least 88.45 %"]
    assert [(row.met, row.networks.partition(",")[0]) for row in rows] == [
        (False, "`compared`: 80"),
        (True, "`released`: 384"),
    ]
    page = page_of(published, "hours", EXPERIMENTS)
    lines = page.splitlines()
    for figure in ("89.1 [87.6, 90.7]", "83.2 [79.6, 86.5]"):
        with_it = [line for line in lines if figure in line]
        assert with_it and all("`released`" in line and "flatters" in line for line in with_it)
    for line in lines:
        if "VPT-TOB + VPN, `released`" in line and line.startswith("|"):
            assert "†" in line
    assert "No network was trained twice" in page
    assert len(lines) < 250 and page == (DOCS / "results.md").read_text(), "docs/results.md is what the writer writes"


def test_the_page_says_what_is_known_of_the_seeds(published: tables.Findings) -> None:
    text = page_of(published, "hours", EXPERIMENTS)
    assert "Shown by their commands: compared/coordinate-end, " in text and "without `--seeds`: 1" in text
    assert "Given, not trained here: released/hazard-attention, released/vpn, released/vpt-tob: their cards are the only" in text
    assert "No figure on this page is known to be of another seed" in text
    published.cards["compared"]["hazard"]["training"]["seed"] = 2
    text = page_of(published, "hours", EXPERIMENTS)
    assert "* **compared/hazard**: its command asks for seed 1, its card says 2." in text
    assert "No figure on this page is known" not in text


@pytest.fixture
def published() -> tables.Findings:
    return tables.Findings(DOCS, "hours")


def test_stages_of_several_seeds_have_their_own_names_and_workspaces() -> None:
    preset = replace(PRESETS["quick"], groups=(replace(PRESETS["quick"].groups[0], seeds=(1, 2)),))
    stages = {stage.name: stage for stage in stages_of("quick", preset, Machine(2, False))}
    first, second = (stages[f"train compared/vpn-seed{seed}"] for seed in (1, 2))
    assert "--seeds" not in first.arguments and second.arguments[second.arguments.index("--seeds") + 1] == "2"
    assert "@/weights/compared/vpt-tob-seed2.safetensors" in second.arguments
    assert second.needs[1] == "train compared/vpt-tob-seed2" and not set(first.scratch) & set(second.scratch)
    assert {"train compared/hazard-seed1", "train compared/hazard-seed2"} <= set(stages["evaluate accuracy"].needs)


def one_set(accuracies: dict[str, float], against: dict[str, dict[str, Any]] | None = None) -> dict[str, Any]:
    methods = {name: {"accuracy": value, "against": (against or {}).get(name, {})} for name, value in accuracies.items()}
    return {"results": [{"start": "uniform", "horizon limit": 200, "examples": 9, "methods": methods}]}


def test_the_order_of_methods_is_stated_as_found() -> None:
    papers = {"self-perspective": 0.77, "coordinate-path": 0.76, "vector-action": 0.83, "vpt-tob": 0.88}
    assert any("No pair" in line for line in tables.ordering(one_set(papers)))
    turned = {**papers, "coordinate-path": 0.90}
    sure = {"coordinate-path": {"vpt-tob": {"difference": 0.02, "interval 95 %": [0.01, 0.03]}}}
    lines = tables.ordering(one_set(turned, sure))
    others = [line for line in lines if line.startswith("* Other than in the paper")]
    assert len(others) == 3 and all("coordinate-value, path is" in line for line in others)
    (by_vpt,) = [line for line in others if "above VPT-TOB" in line]
    assert "2.0 points above" in by_vpt and "excludes 0" in by_vpt
    unsure = {"coordinate-path": {"vpt-tob": {"difference": 0.02, "interval 95 %": [-0.01, 0.05]}}}
    assert any("includes 0" in line for line in tables.ordering(one_set(turned, unsure)))


def test_time_on_the_clock_counts_what_ran_side_by_side_once() -> None:
    spans = [(0.0, 10.0), (5.0, 10.0), (100.0, 1.0), (2.0, 3.0)]
    grid = np.arange(0, 200, 0.5)
    reference = sum(any(began <= at < began + seconds for began, seconds in spans) for at in grid) * 0.5
    assert wall(spans) == pytest.approx(reference)
