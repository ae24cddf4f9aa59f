"""What every training keeps account of: its checkpoint, what another training may not go on from, progress, and what is told."""

import dataclasses
import io
import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from learning import training_run
from learning.group import Group
from learning.recipe import Recipe, VpnRecipe
from learning.training_run import OtherTraining, TrainingRun, training_samples
from learning.training_settings import TrainingSettings, given
from vantage.networks.vpn import Vpn, VpnSettings

CPU = torch.device("cpu")
ALONE = Group(0, 1, CPU)
IDENTITY = {"model": "hazard", "recipe": {"rate": 1e-3, "encoder": (8, 8)}, "data": "hash"}
MEASURES = {"loss": 0.5, "AUROC": 0.75}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Seconds that pass only where a test says so."""
    fake = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(training_run, "time", SimpleNamespace(monotonic=lambda: fake.now))
    return fake


def new_run(workspace: Path, total: int = 100, minutes: float | None = None, **settings: Any) -> TrainingRun:
    given = {"identity": IDENTITY, "group": ALONE, "report_every": 20, **settings}
    return TrainingRun(workspace, total=total, minutes=minutes, **given)


def step(run: TrainingRun, clock: SimpleNamespace, seconds: float = 2.0, samples: int = 10, loss: float = 1.0) -> None:
    clock.now += seconds
    run.count(samples, torch.tensor(loss))


def test_a_resumed_run_counts_on(tmp_path: Path, clock: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    run = new_run(tmp_path)
    assert run.resume() is None
    run.begin()
    step(run, clock, 90.0)
    run.keep_if_best(MEASURES)
    run.write_checkpoint({"trainer": {"network": {"weight": torch.arange(3.0)}}})
    run.finish(tmp_path / "x.safetensors")
    capsys.readouterr()

    later = new_run(tmp_path)
    saved = later.resume()
    assert saved is not None
    assert torch.equal(saved["trainer"]["network"]["weight"], torch.arange(3.0))
    assert (later.seen, later.trained, later.best, later.best_measures) == (10, 90.0, 0.5, MEASURES)
    assert capsys.readouterr().out == "going on after 10 samples, 1.5 minutes\n"
    later.begin()
    assert later.progress == 0.1
    step(later, clock)
    assert (later.seen, later.trained, later.progress) == (20, 92.0, 0.2)
    assert not later.keep_if_best({"loss": 0.6}), "the best is the best of all sittings"


def test_a_checkpoint_has_the_keys_that_it_always_had(tmp_path: Path) -> None:
    """Checkpoints lie in people's workspaces: of vpt-tob and caught with all state under `trainer`, of vpn beside the counts."""
    run = new_run(tmp_path)
    counts = {"identity": IDENTITY, "seen": 0, "trained": 0.0, "best": float("inf"), "best_measures": {}}
    for state in ({"trainer": {"network": {}}}, {"network": {}, "optimizer": {}}):
        run.write_checkpoint(state)
        assert torch.load(tmp_path / "checkpoint.pt", weights_only=True) == {**counts, **state}
    earlier = {"identity": IDENTITY, "trainer": {}, "seen": 40, "trained": 60.0, "best": 0.3, "best_measures": {"loss": 0.3}}
    torch.save(earlier, tmp_path / "checkpoint.pt")
    assert run.resume() == earlier
    assert (run.seen, run.trained, run.best, run.best_measures) == (40, 60.0, 0.3, {"loss": 0.3})


def test_a_checkpoint_of_another_training_is_refused(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    run.seen = 30
    run.write_checkpoint({})
    other = new_run(tmp_path, identity={**IDENTITY, "recipe": {"rate": 1e-3, "encoder": (8, 16)}})
    with pytest.raises(OtherTraining, match=r"checkpoint.pt is of another recipe or training set: choose another --workspace"):
        other.resume()
    assert (other.seen, other.trained) == (0, 0.0)
    with pytest.raises(OtherTraining, match="another recipe, training set or predictor"):
        other.resume("recipe, training set or predictor")
    assert other.resume(settled=lambda earlier: {**earlier, "recipe": other.identity["recipe"]}) is not None
    assert other.seen == 30


def test_an_interrupted_write_leaves_the_checkpoint_before_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = new_run(tmp_path / "run")
    run.seen = 10
    run.write_checkpoint({"trainer": {"weight": torch.ones(1000)}})
    whole, save = (tmp_path / "run" / "checkpoint.pt").read_bytes(), torch.save

    def interrupted(content: object, path: Path) -> None:
        buffer = io.BytesIO()
        save(content, buffer)
        path.write_bytes(buffer.getvalue()[: buffer.tell() // 2])
        raise OSError("no space left on device")

    monkeypatch.setattr(torch, "save", interrupted)
    run.seen = 20
    with pytest.raises(OSError, match="no space"):
        run.write_checkpoint({"trainer": {"weight": torch.zeros(1000)}})
    assert (tmp_path / "run" / "checkpoint.pt").read_bytes() == whole
    later = new_run(tmp_path / "run")
    saved = later.resume()
    assert saved is not None and saved["trainer"]["weight"].all() and later.seen == 10
    monkeypatch.undo()
    later.write_checkpoint({"trainer": {}})  # what is left of the other is in nobody's way
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["checkpoint.pt"]


def test_progress_is_by_samples_or_by_minutes(tmp_path: Path, clock: SimpleNamespace) -> None:
    by_samples, by_minutes = new_run(tmp_path / "a", total=40), new_run(tmp_path / "b", total=40, minutes=2.0)
    for run, expected in ((by_samples, (0.25, 0.5, 1.0)), (by_minutes, (0.25, 0.5, 1.5))):
        run.begin()
        assert run.progress == 0.0
        found = []
        for seconds, samples in ((30.0, 10), (30.0, 10), (120.0, 20)):
            step(run, clock, seconds, samples)
            found.append(run.progress)
            if run.progress == 0.5:
                assert (run.speed, run.minutes_left) == (pytest.approx(20 / 60), pytest.approx(1.0))
        assert found == pytest.approx(expected)
        assert run.minutes_left == 0.0


class SecondOfTwo(Group):
    """A process beside one that is done."""

    def from_first(self, value: float) -> float:
        return 1.0

    def leave(self) -> None:
        pass


def test_validating_and_saving_are_not_time_of_training(tmp_path: Path, clock: SimpleNamespace) -> None:
    run = new_run(tmp_path)
    clock.now += 50.0
    run.begin()
    step(run, clock)
    clock.now += 7.0
    run.report(MEASURES, saved=False)
    step(run, clock)
    clock.now += 7.0
    run.write_checkpoint({})
    step(run, clock)
    assert run.trained == 6.0
    assert run.speed == pytest.approx(20 / 4), "since the report, whatever was saved"


def test_reports_come_by_samples_checkpoints_by_minutes_and_both_at_the_end(tmp_path: Path, clock: SimpleNamespace) -> None:
    run = new_run(tmp_path, total=50, checkpoint_minutes=0.1)
    run.begin()
    due = []
    for _ in range(5):
        step(run, clock)
        due.append((run.report_is_due, run.checkpoint_is_due))
        if run.report_is_due:
            run.report(MEASURES, saved=False)
        if run.checkpoint_is_due:
            run.write_checkpoint({})
    assert due == [(False, False), (True, False), (False, True), (True, False), (True, True)]
    resumed = new_run(tmp_path, total=90, checkpoint_minutes=0.1)
    resumed.resume()
    resumed.begin()
    step(resumed, clock)
    assert not resumed.report_is_due and not resumed.checkpoint_is_due, "both count from where it goes on"


def test_only_a_lower_loss_is_better(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    found = [run.keep_if_best({"loss": loss, "number": number}) for number, loss in enumerate((0.5, 0.5, float("nan"), 0.4, 0.6))]
    assert found == [True, False, False, True, False]
    assert (run.best, run.best_measures) == (0.4, {"loss": 0.4, "number": 3})


def test_a_report_tells_what_was_learnt_since_the_last_one(
    tmp_path: Path, clock: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    run = new_run(tmp_path, total=2000)
    run.begin()
    step(run, clock, samples=400, loss=1.0)
    step(run, clock, samples=100, loss=2.0)
    run.report(MEASURES, saved=True, curves={"training/rate": 1e-3})
    step(run, clock, seconds=56.0, samples=500, loss=3.0)
    run.show("predictions", np.zeros((4, 4, 3), np.uint8))
    run.report(MEASURES, saved=False, pace=f"{run.minutes_left:4.1f} min left")
    run.keep_if_best(MEASURES)
    run.finish(tmp_path / "x.safetensors")
    assert capsys.readouterr().out.splitlines() == [
        " 25.0 %        500 samples   125/s     0 min left  loss 1.2000  validation: loss 0.5000  AUROC 0.7500  * saved",
        " 50.0 %      1,000 samples   1.0 min left  loss 3.0000  validation: loss 0.5000  AUROC 0.7500",
        f"best validation: {MEASURES}; weights in {tmp_path / 'x.safetensors'}",
    ]
    board = EventAccumulator(str(tmp_path)).Reload()
    assert set(board.Tags()["scalars"]) == {"validation/loss", "validation/AUROC", "training/loss", "training/rate"}
    assert {event.step: event.value for event in board.Scalars("training/loss")} == pytest.approx({500: 1.2, 1000: 3.0})
    assert board.Tags()["images"] == ["predictions"]


def test_only_the_first_process_reports_and_writes(
    tmp_path: Path, clock: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    run = new_run(tmp_path, group=SecondOfTwo(1, 2, CPU))
    run.begin()
    step(run, clock, samples=20)
    assert run.progress == 1.0, "as the first has it"
    assert not run.report_is_due and not run.checkpoint_is_due
    assert run.refuse("no") == 1
    run.finish(tmp_path / "x.safetensors")
    assert capsys.readouterr() == ("", "") and not list(tmp_path.iterdir())
    assert new_run(tmp_path).refuse("no") == 1
    assert capsys.readouterr() == ("", "no\n")


def test_processes_share_the_batches_and_go_on_where_they_were() -> None:
    def numbers(rank: int, size: int, seen: int) -> list[int]:
        run = new_run(Path("nowhere"), group=Group(rank, size, CPU))
        run.seen = seen
        return list(itertools.islice(run.batch_numbers(8), 3))

    assert numbers(0, 1, 0) == [0, 1, 2] and numbers(0, 1, 24) == [3, 4, 5]
    assert numbers(0, 2, 0) == [0, 2, 4] and numbers(1, 2, 0) == [1, 3, 5]
    assert numbers(0, 2, 32) == [4, 6, 8] and numbers(1, 2, 32) == [5, 7, 9]


def test_a_batch_depends_on_seed_and_number_alone() -> None:
    drawn: list[tuple[Any, ...]] = []

    def draw(split: str, count: int, generator: np.random.Generator, from_start: float, symmetries: int) -> None:
        drawn.append((split, count, from_start, symmetries, generator.integers(1 << 40)))

    data: Any = SimpleNamespace(draw=draw)
    recipe = Recipe(batch=8, symmetries=4, from_start=0.25)
    list(training_samples(data, recipe, 1, [3, 4]))
    list(training_samples(data, recipe, 1, [4]))
    list(training_samples(data, recipe, 2, [4]))
    assert all(batch[:4] == ("train", 8, 0.25, 4) for batch in drawn)
    assert drawn[1] == drawn[2] and len({batch[4] for batch in drawn}) == 3


def test_the_card_says_what_the_best_weights_came_from(tmp_path: Path, clock: SimpleNamespace) -> None:
    names = ("hash", "episodes", "hiders", "seekers", "layouts", "horizons")
    data: Any = SimpleNamespace(manifest={name: f"its {name}" for name in (*names, "commit")})
    recipe, network = VpnRecipe(network=VpnSettings(width=4)), Vpn(VpnSettings(width=4))
    run = new_run(tmp_path)
    run.begin()
    step(run, clock, 30.0)
    run.keep_if_best(MEASURES)
    card = run.model_card(network, "paper", data, recipe, {"images seen": run.seen}, seed=7)
    assert (card.architecture, card.preset, card.metrics, card.network["width"]) == ("vpn", "paper", MEASURES, 4)
    assert card.data == {name: f"its {name}" for name in names}
    own = {"images seen": 10, "minutes": 0.5, "device": "cpu", "seed": 7}
    expected = {**dataclasses.asdict(recipe), **own}
    expected.pop("network")
    assert card.training == expected and list(card.training)[-4:] == list(own)


def test_settings_that_are_not_given_leave_the_preset_alone() -> None:
    settings = TrainingSettings(model="hazard", preset="paper", samples=0, drop=0.5)
    assert given(settings, "samples", "batch", "drop") == {"samples": 0, "drop": 0.5}
    assert (settings.weights, settings.folder) == (Path("runs/hazard.safetensors"), Path("runs/hazard"))
    told = dataclasses.replace(settings, to=Path("a.safetensors"), workspace=Path("b"), threads=3)
    assert (told.weights, told.folder, told.threads_of(ALONE)) == (Path("a.safetensors"), Path("b"), 3)


def test_processes_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_run.os, "cpu_count", lambda: 6)
    settings = TrainingSettings(model="hazard", preset="paper")
    assert [settings.threads_of(Group(0, size, CPU)) for size in (1, 2, 8)] == [6, 3, 1]
