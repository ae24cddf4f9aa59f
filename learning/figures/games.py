"""Pictures of games of the test split: training pairs, predicted beside true views, methods side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from learning.dataset import Dataset, Samples
from learning.figures.style import (
    QUIET,
    ROBOTS,
    arena,
    color_of,
    new_figure,
    robot,
    show_image,
    title_of,
)
from learning.methods.method import Method
from learning.methods.views import PredictedViews
from schemas import Box
from vantage.perception.palette import view_for_people, view_palette
from vantage.world.layout import make_layout

INTERVAL = 20
"""Steps between the views that are shown (paper, Fig. 4)."""


@dataclass(frozen=True)
class Shown:
    """One game of a training set, to be drawn from its first step on.

    Attributes:
        row: of the episode.
        steps: T.
        caught: step of the catch; None = survived.
        poses: [2, S, 3] x, y (m), heading (rad) of hider and seeker.
        plan: [P, 3] positions planned at step 0.
    """

    row: int
    seed: int
    steps: int
    caught: int | None
    hider: str
    boxes: tuple[Box, ...]
    poses: NDArray[np.float32]
    plan: NDArray[np.float32]

    @property
    def name(self) -> str:
        ending = "survived" if self.caught is None else f"caught at step {self.caught}"
        return f"episode with seed {self.seed}, hider `{self.hider}`, {ending}"

    def at(self, step: int) -> int:
        """Return the recorded step that stands for a step: after the catch the game is frozen."""
        return min(step, self.poses.shape[1] - 1)


def game_of(data: Dataset, row: int) -> Shown:
    """Return the game of an episode's row."""
    episode = data.episodes[row]
    steps = data.steps[episode["first_step"] : episode["first_step"] + episode["steps"]]
    poses = np.stack([np.stack([steps[robot][part] for part in ("x", "y", "heading")], axis=-1) for robot in ("hider", "seeker")])
    plan = data.plans[steps["plan"][0]]
    caught = int(episode["caught_step"])
    return Shown(
        row,
        int(episode["seed"]),
        int(episode["horizon"]),
        None if caught < 0 else caught,
        data.name_of(row, "hider"),
        make_layout(data.name_of(row, "layout"), int(episode["seed"])),
        poses[:, : caught + 1] if caught >= 0 else poses,
        data.positions[plan["first_position"] : plan["first_position"] + plan["positions"]],
    )


def chosen_games(data: Dataset) -> list[Shown]:
    """Return two test games, by rule and not by how well they are predicted: the first that is caught between 2 and 4 fifths of
    T, and the first that survives (or what comes nearest)."""
    rows = data.of_split("test")
    episodes = data.episodes[rows]
    share = np.where(episodes["caught_step"] < 0, 2.0, episodes["caught_step"] / episodes["horizon"])
    late = int(np.argmin(np.where((share >= 0.4) & (share <= 0.8), 0.0, np.abs(share - 0.6))))
    survived = int(np.argmax(share))
    return [game_of(data, int(rows[index])) for index in dict.fromkeys((late, survived))]


def every_interval(game: Shown) -> NDArray[np.int64]:
    """Return the steps that are shown: 19, 39, ... below T and as far as the plan reaches."""
    interval = INTERVAL if game.steps >= 2 * INTERVAL else max(game.steps // 2, 1)
    return np.arange(interval - 1, min(game.steps, len(game.plan)), interval)


def samples_of(game: Shown, steps: NDArray[np.int64]) -> Samples:
    """Return the samples from step 0 of a game to some of its steps, not turned."""
    count = len(steps)
    caught = np.zeros(count, np.bool_) if game.caught is None else steps >= game.caught
    return Samples(np.full(count, game.row, np.int64), np.zeros(count, np.int64), steps, np.zeros(count, np.int64), caught)


def seeker_views(data: Dataset, game: Shown, steps: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return what the seeker truly sees at some steps, in the colours of figures [n, 128, 128, 3]."""
    first = int(data.episodes["first_step"][game.row])
    images = [np.frombuffer(data.image(first + game.at(int(step)), 1), np.uint8).reshape(128, 128) for step in steps]
    return view_palette("seeker")[np.stack(images)]


def training_pairs(data: Dataset, count: int = 3) -> Figure:
    """Draw what VPT-TOB is shown and what it is to predict: I_H, F, T -> I_S (paper, Fig. 2)."""
    samples = data.draw("train", 200, np.random.default_rng(4), symmetries=1)
    wanted = np.flatnonzero((samples.horizon > 0.2 * data.episodes["horizon"][samples.episode]) & (samples.start == 0))[:count]
    wanted = wanted if len(wanted) else np.arange(min(count, len(samples)))
    picked = Samples(
        samples.episode[wanted], samples.start[wanted], samples.horizon[wanted], samples.symmetry[wanted], samples.caught[wanted]
    )
    batch = data.render(picked)
    caption = "F: darker = more visits; T: darker = later; both up to the step asked for."
    title = "What the network is shown, and what it is to predict"
    figure = new_figure(2.95 * len(wanted) + 1.0, title, caption, width=12, views=True)
    height = figure.get_figheight()
    grid = figure.add_gridspec(
        len(wanted), 4, left=0.06, right=0.99, top=1 - 0.8 / height, bottom=0.7 / height, wspace=0.04, hspace=0.12
    )
    titles = ("hider's view now, $I_H$", "visits of the plan, $F$", "times of the plan, $T$", "seeker's view then, $I_S$")
    for row in range(len(wanted)):
        inputs = batch.inputs[row]
        frequency, time = (_on_white(inputs[..., channel], inputs[..., channel + 1]) for channel in (3, 5))
        seen, target = view_for_people(inputs[..., :3], "hider"), view_for_people(batch.targets[row], "seeker")
        pictures = (seen, frequency, time, target)
        for column, picture in enumerate(pictures):
            axes = figure.add_subplot(grid[row, column])
            show_image(axes, picture, titles[column] if row == 0 else "")
            if column == 0:
                verdict = "caught" if picked.caught[row] else "free"
                axes.set_ylabel(f"{picked.horizon[row]} steps ahead\n({verdict})", fontsize=11)
    return figure


def _on_white(luminance: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.where(alpha > 0, luminance, 255).astype(np.uint8)


def predicted_views(data: Dataset, method: PredictedViews, games: list[Shown]) -> Figure:
    """Draw predicted against true seeker views along whole games, under the game from above (paper, Fig. 4)."""
    caption = "A prediction blurs what is uncertain. % is the risk that the VPN reads from the prediction."
    columns = max(len(every_interval(game)) for game in games)
    side = (14.4 - 0.9) / columns
    block = 3 * min(side, 1.9) + 0.85
    title = "The seeker's views, predicted at step 0, beside the true ones"
    figure = new_figure(block * len(games) + 1.2, title, caption, views=True)
    height = figure.get_figheight()
    for index, game in enumerate(games):
        top = 1 - (0.95 + index * block) / height
        grid = figure.add_gridspec(
            3, columns, left=0.06, right=0.995, top=top, bottom=top - (block - 0.6) / height, wspace=0.05, hspace=0.17
        )
        figure.text(0.06, top + 0.26 / height, game.name, fontsize=12)
        steps = every_interval(game)
        samples = samples_of(game, steps)
        questions = data.questions(samples)
        views, risk = view_for_people(method.predict(questions), "seeker"), _probability(method.judge(questions))
        true = seeker_views(data, game, steps)
        for column, step in enumerate(steps):
            above, middle, below = (figure.add_subplot(grid[row, column]) for row in range(3))
            _from_above(above, game, int(step))
            above.set_title(f"step {step}", fontsize=10)
            show_image(middle, views[column], f"{risk[column]:.0%}")
            show_image(below, true[column], "caught" if samples.caught[column] else "free")
            if column == 0:
                for axes, label in ((above, "from above"), (middle, "predicted"), (below, "true")):
                    axes.set_ylabel(label, fontsize=11)
    return figure


def _from_above(axes: Axes, game: Shown, step: int) -> None:
    arena(axes, game.boxes, ticks=False)
    planned = game.plan[: step + 1]
    axes.plot(planned[:, 0], planned[:, 1], "--", color="black", linewidth=0.8, zorder=4)
    for index, who in enumerate(("hider", "seeker")):
        track = game.poses[index, : game.at(step) + 1]
        axes.plot(track[:, 0], track[:, 1], color=ROBOTS[who], linewidth=1.4, zorder=4)  # type: ignore[index]
        robot(axes, who, *map(float, track[-1]))  # type: ignore[arg-type]


def _probability(logits: NDArray[np.float32]) -> NDArray[np.float64]:
    return 0.5 * (1 + np.tanh(0.5 * logits.astype(np.float64)))


def side_by_side(data: Dataset, methods: list[Method], game: Shown) -> Figure:
    """Draw the views that each method predicts for one game, and every method's risk over time (paper, Fig. 5)."""
    steps = every_interval(game)
    shown = steps[np.linspace(0, len(steps) - 1, min(5, len(steps))).astype(int)]
    painters = [method for method in methods if isinstance(method, PredictedViews)]
    samples = samples_of(game, shown)
    questions, true = data.questions(samples), seeker_views(data, game, shown)
    rows = 1 + len(painters)
    figure = new_figure(max(1.45 * rows + 1.9, 5.0), f"Methods side by side: {game.name}", views=True)
    height = figure.get_figheight()
    edges = {"top": 1 - 0.85 / height, "bottom": 0.75 / height}
    grid = figure.add_gridspec(rows, len(shown), left=0.105, right=0.56, wspace=0.05, hspace=0.12, **edges)
    for row in range(rows):
        method = painters[row - 1] if row else None
        pictures = true if method is None else method.predict(questions)
        if method is not None:
            pictures = view_for_people(pictures, "hider" if method.name == "self-perspective" else "seeker")
        for column in range(len(shown)):
            axes = figure.add_subplot(grid[row, column])
            show_image(axes, pictures[column], f"step {shown[column]}" if row == 0 else "")
            if column == 0:
                own = "\n(hider's own view)" if method is not None and method.name == "self-perspective" else ""
                label = "true" if method is None else title_of(method.name).replace(" + VPN", "")
                color = "black" if method is None else color_of(method.name)
                axes.set_ylabel(label + own, fontsize=10, rotation=0, ha="right", va="center", color=color)
    last = min(game.steps, len(game.plan))
    ahead = np.arange(0, last, max(last // 50, 1))
    axes = figure.add_subplot(figure.add_gridspec(1, 1, left=0.62, right=0.985, **edges)[0])
    asked = data.questions(samples_of(game, ahead))
    for one in methods:
        risk = 100 * _probability(one.judge(asked))
        axes.plot(ahead, risk, color=color_of(one.name), linewidth=2, label=title_of(one.name))
    if game.caught is not None:
        axes.axvline(game.caught, color="black", linewidth=1, linestyle="--", label="the catch")
    axes.set_xlabel("steps ahead, as judged at step 0", fontsize=11)
    axes.set_ylabel("risk to be caught by then, %", fontsize=11)
    axes.set_ylim(-2, 102)
    axes.set_xlim(0, last)
    axes.grid(color="0.9")
    axes.tick_params(colors=QUIET)
    axes.legend(fontsize=10, loc="best", framealpha=0.85)
    return figure
