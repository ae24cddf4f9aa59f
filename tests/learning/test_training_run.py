"""What every training keeps account of: its checkpoint, what another training may not go on from, progress, and what is told."""

import dataclasses
import errno
import itertools
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from learning import training_run, training_settings
from learning.group import Group
from learning.recipe import Recipe, VpnRecipe
from learning.training_identity import OtherTraining
from learning.training_run import NotWritten, TrainingRun, training_samples
from learning.training_settings import Place, TrainingSettings, UnusableTraining, given, places_of
from vantage.errors import UserError
from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.weights import ModelCard, card_of, card_path, load_any, read_card, save

CPU = torch.device("cpu")
ALONE = Group(0, 1, CPU)
IDENTITY = {"seed": 1, "model": "hazard", "recipe": {"rate": 1e-3, "encoder": (8, 8)}, "data": "hash"}
MEASURES = {"loss": 0.5, "AUROC": 0.75}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Seconds that pass only where a test says so."""
    fake = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(training_run, "time", SimpleNamespace(monotonic=lambda: fake.now))
    return fake


def new_run(workspace: Path, total: int = 100, minutes: float | None = None, **settings: Any) -> TrainingRun:
    given = {"identity": IDENTITY, "group": ALONE, "report_every": 20, **settings}
    return TrainingRun(Place(1, workspace / "x.safetensors", workspace), total=total, minutes=minutes, **given)


NETWORK = Vpn(VpnSettings(width=4, hidden=8))


def train(run: TrainingRun, losses: list[float] | None = None) -> None:
    """Learn ten samples a step; the validations measure these losses, or ever lower ones."""
    left = iter(losses) if losses else (1.0 / number for number in itertools.count(1))

    def step() -> tuple[int, torch.Tensor]:
        with torch.no_grad():
            next(iter(NETWORK.parameters())).add_(1.0)
        return 10, torch.tensor(1.0)

    def validate() -> dict[str, float]:
        return {"loss": next(left)}

    def card() -> ModelCard:
        made = card_of(NETWORK)
        made.training = {"samples": run.seen, "seed": run.identity["seed"]}
        return made

    run.train(step, validate, NETWORK, card, lambda: {"state": run.seen})


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
    capsys.readouterr()

    later = new_run(tmp_path)
    saved = later.resume()
    assert saved is not None
    assert torch.equal(saved["trainer"]["network"]["weight"], torch.arange(3.0))
    assert (later.seen, later.trained, later.best, later.best_measures) == (10, 90.0, 0.5, MEASURES)
    assert capsys.readouterr().out == "going on after 10 samples in 1.5 minutes\n"
    later.begin()
    assert later.progress == 0.1
    step(later, clock)
    assert (later.seen, later.trained, later.progress) == (20, 92.0, 0.2)
    assert not later.keep_if_best({"loss": 0.6}), "the best is the best of all sittings"


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"seed": 2}, r"\(seed 1 there, 2 here\)"),
        ({"recipe": {"rate": 1e-3, "encoder": (8, 16)}}, r"\(recipe encoder \(8, 8\) there, \(8, 16\) here\)"),
        ({"data": "other"}, r"\(data hash there, other here\)"),
        ({"processes": 2}, r"\(processes unknown there, 2 here\)"),
    ],
)
def test_a_checkpoint_of_another_training_is_refused(tmp_path: Path, changed: dict[str, Any], says: str) -> None:
    run = new_run(tmp_path)
    run.seen = 30
    run.write_checkpoint({})
    other = new_run(tmp_path, identity={**IDENTITY, **changed})
    with pytest.raises(OtherTraining, match=rf"checkpoint.pt is of another training {says}: choose another --to, or --force"):
        other.resume()
    with pytest.raises(OtherTraining):
        other.resume(go_on=False)
    assert (other.seen, other.trained) == (0, 0.0)
    assert new_run(tmp_path, identity={**IDENTITY, **changed}, force=True).resume() is None
    assert new_run(tmp_path).resume() is not None, "nothing is replaced before there is something to replace it with"


def test_a_checkpoint_of_an_earlier_version_is_of_an_unknown_seed(tmp_path: Path) -> None:
    earlier = {name: value for name, value in IDENTITY.items() if name != "seed"}
    torch.save({"identity": earlier, "trainer": {}, "seen": 40, "trained": 60.0}, tmp_path / "checkpoint.pt")
    with pytest.raises(OtherTraining, match="seed unknown there, 1 here"):
        new_run(tmp_path).resume()


@pytest.mark.parametrize("content", [b"", b"text", "list"])
def test_a_damaged_checkpoint_is_named_in_one_line(tmp_path: Path, content: bytes | str) -> None:
    if isinstance(content, str):
        torch.save([1], tmp_path / "checkpoint.pt")
    else:
        (tmp_path / "checkpoint.pt").write_bytes(content)
    with pytest.raises(UserError, match=r"checkpoint.pt cannot be read .*--force to begin again") as caught:
        new_run(tmp_path).resume()
    assert "\n" not in str(caught.value)
    assert new_run(tmp_path, force=True).resume() is None


def test_weights_of_another_training_are_never_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights = tmp_path / "x.safetensors"
    save(NETWORK, weights, card_of(NETWORK))  # of an earlier version, or given
    before = weights.read_bytes()
    for go_on in (True, False):
        with pytest.raises(OtherTraining, match=r"x.safetensors holds weights of another training.*--force"):
            new_run(tmp_path).resume(go_on)
    weights.unlink()
    with pytest.raises(OtherTraining):
        new_run(tmp_path).resume()  # the card of other weights would be written over
    weights.write_bytes(before)
    run = new_run(tmp_path, total=20, force=True)
    assert run.resume() is None
    train(run)
    assert weights.read_bytes() != before
    other = new_run(tmp_path, identity={**IDENTITY, "seed": 2})
    other.checkpoint = tmp_path / "elsewhere" / "checkpoint.pt"
    with pytest.raises(OtherTraining, match="holds weights of another training"):
        other.resume()
    again = new_run(tmp_path)
    again.checkpoint = tmp_path / "elsewhere" / "checkpoint.pt"
    with pytest.raises(UserError, match="not the checkpoint of its training: --no-resume begins again"):
        again.resume()
    assert again.resume(go_on=False) is None


def test_nothing_left_to_train_is_one_line_and_the_weights_are_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights = tmp_path / "x.safetensors"
    first = new_run(tmp_path, total=40)
    first.resume()
    train(first)
    first.finish()
    found, card = load_any(weights)
    assert (card.training["samples"], card.training["seed"]) == (40, 1)
    spoils = {
        "weights": lambda: weights.unlink(),
        "card": lambda: card_path(weights).unlink(),
        "page": lambda: weights.with_suffix(".md").unlink(),
        "all": lambda: [path.unlink() for path in tmp_path.glob("x.*")],
        "bytes": lambda: weights.write_bytes(b"damaged"),
        "nothing": lambda: None,
    }
    for name, spoil in spoils.items():
        spoil()
        capsys.readouterr()
        again = new_run(tmp_path, total=40)
        assert again.resume() is not None and again.is_over
        lines = capsys.readouterr().out.splitlines()
        assert lines[-1].startswith(f"nothing left to train: {weights} has learnt from 40 samples in"), name
        assert lines[:-1] == ([] if name == "nothing" else [f"{weights} was gone or damaged: written again, from the checkpoint"])
        network, card_again = load_any(weights)
        assert all(torch.equal(a, b) for a, b in zip(network.state_dict().values(), found.state_dict().values(), strict=True))
        assert (card_again.training["samples"], card_again.identity) == (40, card.identity)
    with pytest.raises(UserError, match=r"has learnt from 40 samples in .* already, all that is asked for or more"):
        new_run(tmp_path, total=20).resume()
    more = new_run(tmp_path, total=60)
    assert more.resume() is not None and not more.is_over
    train(more, [0.9, 0.9])
    more.finish()
    assert read_card(weights).training["samples"] == 60
    assert read_card(weights).sha256 == card.sha256, "the best weights are those of the first sitting"


def test_the_card_of_a_training_that_was_killed_before_it_finished_is_completed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = tmp_path / "x.safetensors"
    killed = new_run(tmp_path, total=40)
    killed.resume()
    train(killed, [0.5, 0.9])
    assert read_card(weights).training["samples"] == 20, "of the best weights"
    for completed in ([f"{card_path(weights)} was not final: completed, from the checkpoint"], []):
        capsys.readouterr()
        again = new_run(tmp_path, total=40)
        again.resume()
        assert again.is_over
        assert capsys.readouterr().out.splitlines()[:-1] == completed
        training = read_card(weights).training
        assert (training["samples"], training["minutes"]) == (40, killed.trained / 60)


def test_a_full_disk_ends_it_with_one_line_and_keeps_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = new_run(tmp_path, total=40)
    run.resume()
    train(run)
    run.finish()
    kept = {name: (tmp_path / name).read_bytes() for name in ("checkpoint.pt", "x.safetensors", "x.json", "x.md")}
    more = new_run(tmp_path, total=80, checkpoint_minutes=3.0)
    more.resume()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(
        NotWritten, match=r"No space left on device; free some space.* The training ends after 60 samples"
    ) as caught:
        train(more, [0.01])
    assert "the checkpoint before it is kept" in str(caught.value) and "\n" not in str(caught.value)
    assert {name: (tmp_path / name).read_bytes() for name in kept} == kept
    assert not list(tmp_path.glob(".*"))


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

    def agree(self, progress: float, stop: bool) -> tuple[float, bool]:
        return 1.0, stop

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
            run._validated = run.seen
            run.report(MEASURES, saved=False)
        if run.checkpoint_is_due:
            run.write_checkpoint({})
    first, at_the_end = (False, True), (True, True)
    assert due == [first, (True, False), (False, False), (True, True), at_the_end], "the first step is kept, too"
    resumed = new_run(tmp_path, total=90, checkpoint_minutes=0.1)
    resumed.resume()
    resumed.begin()
    step(resumed, clock)
    assert not resumed.report_is_due and not resumed.checkpoint_is_due, "both count from where it goes on"


def test_a_stop_finishes_the_step_and_writes_the_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = iter([False, False, True])
    monkeypatch.setattr(training_run, "stop_requested", lambda: next(asked))
    run = new_run(tmp_path, report_every=1000)
    run.resume()
    with pytest.raises(KeyboardInterrupt, match=r"the checkpoint after 20 samples in .* is kept; the same command goes on"):
        train(run)
    monkeypatch.setattr(training_run, "stop_requested", lambda: False)
    later = new_run(tmp_path)
    saved = later.resume()
    assert saved is not None and saved["state"] == later.seen == 20


def test_a_stop_in_a_validation_leaves_it_to_the_next_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = new_run(tmp_path, total=20)
    run.resume()

    def validate() -> dict[str, float]:
        monkeypatch.setattr(training_run, "stop_requested", lambda: True)
        return {"loss": float(sum(run.interruptible([1.0, 2.0])))}

    with pytest.raises(KeyboardInterrupt, match="after 20 samples"):
        run.train(lambda: (20, torch.tensor(1.0)), validate, NETWORK, lambda: card_of(NETWORK), dict)
    monkeypatch.setattr(training_run, "stop_requested", lambda: False)
    later = new_run(tmp_path, total=20)
    later.resume()
    assert not later.is_over and not (tmp_path / "x.safetensors").exists()
    train(later, [0.5])
    later.finish()
    assert later.is_over and load_any(tmp_path / "x.safetensors")


def test_weights_are_not_made_up_where_the_loss_was_never_a_number(tmp_path: Path) -> None:
    run = new_run(tmp_path, total=20)
    run.resume()
    train(run, [float("nan")])
    with pytest.raises(UserError, match="the validation loss was never a number: no weights were written"):
        run.finish()
    assert not (tmp_path / "x.safetensors").exists()


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
    run.report(MEASURES, saved=False)
    run.keep_if_best(MEASURES)
    run.weights.keep(NETWORK, card_of(NETWORK))
    run.finish()
    assert capsys.readouterr().out.splitlines() == [
        " 25.0 %        500 samples   125/s   0.2 min left  loss 1.2000  validation: loss 0.5000  AUROC 0.7500  * saved",
        " 50.0 %      1,000 samples     9/s   1.0 min left  loss 3.0000  validation: loss 0.5000  AUROC 0.7500",
        f"best validation: loss 0.5000, AUROC 0.7500; weights in {tmp_path / 'x.safetensors'}",
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
    run.finish()
    assert capsys.readouterr() == ("", "") and not list(tmp_path.iterdir())


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
    run = new_run(tmp_path, unit="images")
    run.begin()
    step(run, clock, 30.0)
    run.keep_if_best(MEASURES)
    card = run.model_card(network, "paper", data, recipe, ["A note."])
    assert (card.notes, card.training["seed"]) == (["A note."], 1)
    assert (card.architecture, card.preset, card.metrics, card.network["width"]) == ("vpn", "paper", MEASURES, 4)
    assert card.data == {name: f"its {name}" for name in names}
    own = {"images seen": 10, "minutes": 0.5, "best after": 10, "device": "cpu", "seed": 1}
    expected = {**dataclasses.asdict(recipe), **own}
    expected.pop("network")
    assert card.training == expected and list(card.training)[-5:] == list(own)


def test_settings_that_are_not_given_leave_the_preset_alone() -> None:
    settings = TrainingSettings(model="hazard", preset="paper", samples=8, drop=0.0)
    assert given(settings, "samples", "batch", "drop") == {"samples": 8, "drop": 0.0}


def test_the_workspace_follows_the_weights_and_each_seed_has_its_own() -> None:
    def places(**settings: Any) -> list[tuple[int, str, str]]:
        found = places_of(TrainingSettings(model="hazard", preset="paper", **settings), "hazard")
        return [(place.seed, str(place.weights), str(place.workspace)) for place in found]

    assert places() == [(1, "runs/hazard.safetensors", "runs/hazard")]
    assert places(seeds=(2,), to=Path("a/b.safetensors")) == [(2, "a/b.safetensors", "a/b")]
    assert places(workspace=Path("w")) == [(1, "runs/hazard.safetensors", "w")]
    assert places(seeds=(1, 3)) == [
        (1, "runs/hazard-seed1.safetensors", "runs/hazard-seed1"),
        (3, "runs/hazard-seed3.safetensors", "runs/hazard-seed3"),
    ]
    assert [place[2] for place in places(seeds=(1, 3), workspace=Path("w"))] == ["w/seed1", "w/seed3"]
    for wrong in ({"seeds": ()}, {"seeds": (1, 1)}, {"seeds": (-1,)}, {"to": Path("a.pt")}, {"samples": 0}, {"minutes": -1.0}):
        with pytest.raises(UnusableTraining, match="--"):
            places(**wrong)


def test_processes_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_settings, "available_cores", lambda: 6)
    settings = TrainingSettings(model="hazard", preset="paper")
    assert [settings.threads_of(Group(0, size, CPU)) for size in (1, 2, 8)] == [6, 3, 1]
    assert dataclasses.replace(settings, threads=3).threads_of(ALONE) == 3
