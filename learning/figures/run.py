"""One run: the hider paints its value map with given weights, chooses a goal and drives there."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib.figure import Figure

from learning.figures.style import new_figure
from learning.in_process import play
from learning.picture import draw_arena, draw_value_map
from schemas import Players, Rules
from services.planner.core import PlannerCore
from services.predictor.core import PredictorCore, PredictorSettings
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore
from services.simulator.core import SimulatorCore
from vantage.log import LogWriter, read
from vantage.log.episodes import EPISODE_TOPICS, EpisodeLog, episodes
from vantage.networks.inference import Inference
from vantage.service import Core

_START = 1_767_225_600_000_000_000  # ns; the virtual clock's, and nothing depends on it


def play_run(weights: Path, layout: str, seeker: str, seed: int, steps: int, threads: int = 0) -> EpisodeLog:
    """Play one whole game in process with the planner as hider, and return it.

    Raises:
        UnusableWeights: see `vantage.networks.weights.load`.
    """
    settings = PredictorSettings(weights=weights, threads=threads)
    referee = RefereeSettings(
        autoplay=True,
        games=1,
        seed=seed,
        rules=Rules(maximum_steps=steps, layout=layout, step_period=0.0),
        players=Players(seeker=seeker),
        required=("simulator", "seeker", "planner", "predictor"),
        settle=0.0,
    )
    cores: dict[str, Core] = {
        "simulator": SimulatorCore(),
        "seeker": SeekerCore(),
        "planner": PlannerCore(),
        "predictor": PredictorCore(Inference.of_weights(weights, settings.batch, threads), settings),
        "referee": RefereeCore(referee),
    }
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        with LogWriter(path, {}, sync=False) as writer:
            play(cores, 1, _START, writer)
        (game,) = episodes(read(path, topics=EPISODE_TOPICS))
    return game


def run(game: EpisodeLog) -> Figure:
    """Draw a run: the arena with both paths beside the value map that led there (paper, Fig. 7)."""
    episode = game.episode
    ending = f"caught at step {episode.caught_step}" if episode.outcome == "caught" else f"{episode.outcome} {game.steps} steps"
    title = f"A run by the value map of VPT-TOB: {ending}"
    caption = (
        f"Seed {episode.seed}, layout {episode.rules.layout}, seeker {episode.players.seeker}; a step is 10 mm or 10 degrees."
    )
    figure = new_figure(7.4, title, caption, width=13)
    grid = figure.add_gridspec(1, 2, left=0.045, right=0.94, top=0.88, bottom=0.17, wspace=0.12)
    draw_arena(figure.add_subplot(grid[0]), game)
    draw_value_map(figure.add_subplot(grid[1]), game)
    return figure
