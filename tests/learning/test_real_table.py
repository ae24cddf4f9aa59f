"""A log of a real table (rehearsed: rendered cameras, emulated robots) converts and trains like a simulated one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from learning import train_caught
from learning.collect import CollectSettings, play_block
from learning.convert import convert
from learning.dataset import Dataset
from learning.hiders.core import HiderCore
from learning.hiders.random_primitives import RandomPrimitives
from learning.recipe import CAUGHT_PRESETS
from learning.splits import SPLITS, split_of
from learning.train_caught import TrainCaughtSettings
from schemas import Episode, Players, Rules
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore, SeekerSettings
from tests.contract.tables import Calibration, RehearsedTable, calibrate
from vantage.bus import Sample
from vantage.log import LogWriter, RunMetadata
from vantage.perception.palette import OTHER, OWN
from vantage.service import Runtime
from vantage.world.arena import TURN

STEPS = 10
TRAIN = SPLITS.index("train")


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    return calibrate(tmp_path_factory.mktemp("calibration"))


def record_real_game(calibration: Calibration, seed: int, path: Path) -> Episode:
    """Play one game at the rehearsed table, referee, seeker and hider as in simulation, into a log; return how it ended."""
    table = RehearsedTable(calibration)
    rules = Rules(maximum_steps=STEPS, layout="lab", step_period=0.0, start_distance_minimum=0.35)
    referee = RefereeSettings(
        autoplay=True,
        games=1,
        seed=seed,
        first_episode=seed,
        rules=rules,
        players=Players(hider="random", seeker="expert"),
        required=("simulator|tracker", "simulator|robot|onboard", "seeker", "hider"),
    )
    hider = HiderCore(lambda episode: RandomPrimitives(episode.rules.maximum_steps, np.random.default_rng(episode.seed)))
    players = {"referee": RefereeCore(referee), "seeker": SeekerCore(SeekerSettings())}
    table.runtimes += [Runtime(core, table.sessions[name], table.clock) for name, core in players.items()]
    table.runtimes.append(Runtime(hider, table.network.session("hider"), table.clock))
    ears = table.network.session("console")
    ears.subscribe("**", raw=True)
    ended: list[Episode] = []
    with LogWriter(path, RunMetadata(commit="test", arena="table", started=table.clock()), sync=False) as log:

        def over() -> bool:
            while (event := ears.receive(0.0)) is not None:
                if isinstance(event, Sample) and "/camera/" not in event.key and event.key != "overhead/color":
                    times = {"log_time": event.published, "publish_time": event.published, "sequence": event.sequence}
                    log.write(event.key, event.payload, publisher=event.publisher, **times)
                    if event.key == "episode" and (message := event.decode()).phase in ("ended", "aborted"):  # type: ignore[attr-defined]
                        ended.append(message)  # type: ignore[arg-type]
            return bool(ended)

        assert table.run(over, 90.0), table.troubles()
    return ended[0]


def test_a_mixture_of_real_and_simulated_games_trains(
    calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.set_num_threads(1)
    seed = next(seed for seed in range(1, 100) if split_of(seed) == TRAIN)
    (tmp_path / "logs").mkdir()
    ended = record_real_game(calibration, seed, tmp_path / "logs" / "real.mcap")
    assert (ended.phase, ended.outcome, ended.step) == ("ended", "survived", STEPS), ended
    simulated = CollectSettings(hider="random", seed=1000, steps=STEPS, layout="lab", start_distance=(0.35, 0.45))
    play_block(simulated, range(1, 25), tmp_path / "logs" / "simulated.mcap")
    convert(sorted((tmp_path / "logs").glob("*.mcap")), tmp_path / "dataset", workers=1, quiet=True)
    data = Dataset(tmp_path / "dataset")
    assert len(data.episodes) == 25

    (row,) = np.flatnonzero(data.episodes["seed"] == seed)
    real = data.episodes[row]
    assert (real["hider"], real["steps"], SPLITS[real["split"]]) == (b"random", STEPS + 1, "train")
    steps = data.steps[real["first_step"] : real["first_step"] + real["steps"]]
    for robot in ("hider", "seeker"):
        path = np.stack([steps[robot][name] for name in ("x", "y", "heading")], axis=1)
        moved = np.hypot(*np.diff(path[:, :2], axis=0).T)
        turned = np.abs(np.remainder(np.diff(path[:, 2]) + np.pi, 2 * np.pi) - np.pi)
        assert moved.max() < 0.016 and turned.max() < TURN + 0.07  # no more than a primitive and its tolerances
    first = np.frombuffer(data.image(int(real["first_step"]), 0), np.uint8)
    assert (first == OWN).sum() > 100 and (first == OTHER).sum() > 50, "at the start the robots see each other"

    samples = data.draw("train", 400, np.random.default_rng(0))
    assert {True, False} == set((samples.episode == row).tolist())
    settings = TrainCaughtSettings(
        model="hazard-attention",
        data=data.folder,
        to=tmp_path / "hazard-attention.safetensors",
        preset="compact",
        samples=4 * CAUGHT_PRESETS["compact"].batch,
        workspace=tmp_path / "run",
        validation=32,
        threads=1,
        compile="off",
    )
    assert train_caught.main(settings) == 0
