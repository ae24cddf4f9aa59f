"""One picture of one game: the arena with both paths, the value map, and predicted beside true seeker views.

Everything is read from the game's log.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from learning.figures.style import BOX, DANGER_MAP, ROBOTS, view_legend
from schemas import STATE_IMAGE_SIZE, Plan, Pose, PredictReply, PredictRequest
from vantage.log.episodes import EPISODE_TOPICS, EpisodeLog, episodes
from vantage.log.reader import read
from vantage.output import complete
from vantage.perception.palette import view_for_people, view_palette
from vantage.perception.state_image import perceive
from vantage.world.arena import ARENA_SIZE, GOALS, ROBOT_RADIUS, goal_name

VIEW_INTERVAL = 20
"""Steps between the seeker views that are shown (paper, Fig. 4)."""


@dataclass(frozen=True)
class Game:
    """One game as its log tells it.

    Attributes:
        log: messages by step.
        predicted: step -> (predicted seeker view uint8 [128, 128, 3], probability that the hider is caught by then).
    """

    log: EpisodeLog
    predicted: dict[int, tuple[NDArray[np.uint8], float]]


def read_game(path: Path) -> Game:
    """Read the last game of a log.

    Raises:
        ValueError: the log holds no game.
    """
    games = list(episodes(read(path, topics=EPISODE_TOPICS)))
    if not games:
        raise ValueError(f"{path} holds no game")
    log = games[-1]
    predicted: dict[int, tuple[NDArray[np.uint8], float]] = {}
    requests: list[PredictRequest] = []
    for record in read(path, topics=("predictor/request", "predictor/reply")):
        message = record.decode()
        if isinstance(message, PredictRequest):
            requests.append(message)
        elif isinstance(message, PredictReply) and requests:
            request = requests.pop(0)
            if request.views and request.episode == log.number:
                predicted.update(_views_of(request, message))
    return Game(log, predicted)


def draw(game: Game, path: Path) -> None:
    """Write the picture of a game as PNG."""
    figure = Figure(figsize=(13, 12.4), dpi=100, facecolor="white")
    margins = {"left": 0.045, "right": 0.94, "top": 0.90, "bottom": 0.03}
    grid = figure.add_gridspec(2, 1, height_ratios=(1.3, 1.0), hspace=0.26, **margins)
    log = game.log
    rules = log.episode.rules
    ending = {
        "caught": f"the seeker caught the hider at step {log.episode.caught_step}",
        "survived": f"the hider survived all {rules.maximum_steps} steps",
    }
    outcome = ending.get(log.episode.outcome, f"the game did not end: {log.episode.reason or log.episode.phase}")
    figure.suptitle(f"Hide-and-seek: {outcome}", fontsize=18, fontweight="bold", x=0.045, ha="left", y=0.98)
    game_facts = f"episode {log.number}, seed {log.episode.seed}, layout {rules.layout}"
    details = f"{game_facts}, seeker preset {log.episode.players.seeker}; one step is 10 mm or 10 degrees"
    figure.text(0.045, 0.937, details, fontsize=11, color="0.35")
    maps = grid[0].subgridspec(1, 2, wspace=0.10)
    draw_arena(figure.add_subplot(maps[0]), log)
    draw_value_map(figure.add_subplot(maps[1]), log)
    steps = sorted(game.predicted) or list(range(VIEW_INTERVAL - 1, rules.maximum_steps, VIEW_INTERVAL))
    strip = grid[1].subgridspec(2, len(steps), hspace=0.22, wspace=0.05)
    for column, step in enumerate(steps):
        top, bottom = figure.add_subplot(strip[0, column]), figure.add_subplot(strip[1, column])
        if step in game.predicted:
            view, caught = game.predicted[step]
            top.imshow(view_for_people(view, "seeker"), interpolation="nearest")
            top.set_title(f"step {step}: {caught:.0%} risk to be caught", fontsize=10)
        true, when = _true_view(log, step)
        if true is not None:
            bottom.imshow(true, interpolation="nearest")
            bottom.set_title(when, fontsize=10)
        for axes in (top, bottom):
            axes.set_xticks([])
            axes.set_yticks([])
        if column == 0:
            top.set_ylabel("predicted by the hider\nat its first look", fontsize=11)
            bottom.set_ylabel("true: what the\nseeker saw", fontsize=11)
    figure.text(0.52, 0.008, "seeker's views from above; a prediction blurs what is uncertain", fontsize=10, color="0.35")
    view_legend(figure, 0.045 * 13, 0.1)
    with complete(path) as partial:
        figure.savefig(partial)


def draw_arena(axes: Axes, log: EpisodeLog) -> None:
    """Draw the arena from above with both paths and the hider's plan."""
    _frame(axes, "The game from above", log)
    for robot in ("hider", "seeker"):
        track = _track(log.poses[robot])  # [n, 3]
        if len(track) == 0:
            continue
        color = ROBOTS[robot]
        axes.plot(track[:, 0], track[:, 1], color=color, linewidth=2.5, zorder=4, label=f"{robot}'s path")
        for step in range(0, len(track), VIEW_INTERVAL):
            axes.plot(*track[step, :2], "o", color=color, markeredgecolor="black", markersize=5, zorder=5)
        axes.add_patch(
            Circle(
                (track[0, 0], track[0, 1]), ROBOT_RADIUS, facecolor="none", edgecolor=color, linewidth=2, linestyle=":", zorder=5
            )
        )
        axes.add_patch(Circle((track[-1, 0], track[-1, 1]), ROBOT_RADIUS, facecolor=color, edgecolor="black", zorder=6))
        x, y, heading = track[-1]
        tip = (x + ROBOT_RADIUS * math.cos(heading), y + ROBOT_RADIUS * math.sin(heading))
        axes.plot([x, tip[0]], [y, tip[1]], color="black", linewidth=2, zorder=7)
        other = _track(log.poses["seeker" if robot == "hider" else "hider"])
        above = y < 0.15 or (len(other) > 0 and other[-1, 1] < y)  # beside the disc, not under the other one's
        place = (x, y + (ROBOT_RADIUS + 0.012) * (1 if above else -1))
        axes.annotate(robot, place, ha="center", va="bottom" if above else "top", fontsize=10, zorder=8)
    plan = _first_plan(log)
    if plan is not None:
        planned = np.frombuffer(plan.path, np.float32).reshape(-1, 3)
        axes.plot(planned[:, 0], planned[:, 1], "--", color="black", linewidth=1.2, zorder=5, label="hider's plan")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.10), ncols=3, fontsize=10, frameon=False)
    axes.set_xlabel(f"metres; dotted disc: start, filled disc: end, a dot every {VIEW_INTERVAL} steps", fontsize=10)


def draw_value_map(axes: Axes, log: EpisodeLog) -> None:
    """Draw the value map that the hider painted first, and the goal that it chose."""
    plan = _first_plan(log)
    _frame(axes, "The hider's value map: danger of each goal", log)
    if plan is None or not plan.values:
        axes.text(0.6, 0.6, "no plan was recorded", ha="center")
        return
    checkpoint_count = plan.horizon // plan.checkpoint_interval
    danger = np.array([np.nan if value is None else value for value in plan.values]).reshape(11, 11)
    image = axes.imshow(np.ma.masked_invalid(danger), origin="lower", extent=(0.05, 1.15, 0.05, 1.15), cmap=DANGER_MAP, zorder=1)
    for goal in np.flatnonzero(np.isnan(danger.ravel())):
        x, y = GOALS[goal]
        axes.plot(x, y, "x", color="0.35", markersize=9, zorder=3)
    if plan.goal is not None:
        axes.plot(*GOALS[plan.goal], "*", color="gold", markeredgecolor="black", markersize=24, zorder=6)
    start = log.poses["hider"].get(plan.step)
    if start is not None:
        axes.add_patch(Circle((start.x, start.y), ROBOT_RADIUS, facecolor=ROBOTS["hider"], edgecolor="black", zorder=5))
    bar = axes.figure.colorbar(image, ax=axes, fraction=0.046, pad=0.02)
    bar.set_label(f"danger: caught at so many of {checkpoint_count} checkpoints (expected)", fontsize=10)
    chosen = "no goal chosen" if plan.goal is None else f"star: the chosen {goal_name(plan.goal)}"
    axes.set_xlabel(f"metres; {chosen}; disc: the hider; x: blocked", fontsize=10)


def _frame(axes: Axes, title: str, log: EpisodeLog) -> None:
    axes.set_title(title, fontsize=13, loc="left")
    axes.set_xlim(0, ARENA_SIZE)
    axes.set_ylim(0, ARENA_SIZE)
    axes.set_aspect("equal")
    axes.set_xticks(np.arange(0.0, 1.21, 0.2))
    axes.set_yticks(np.arange(0.0, 1.21, 0.2))
    for box in log.layout.obstacles if log.layout else ():
        corner = (-box.half_width, -box.half_depth)
        place = Affine2D().rotate(box.heading).translate(box.x, box.y) + axes.transData
        axes.add_patch(Rectangle(corner, 2 * box.half_width, 2 * box.half_depth, color=BOX, zorder=3, transform=place))


def _first_plan(log: EpisodeLog) -> Plan | None:
    return log.plans[min(log.plans)] if log.plans else None


def _track(poses: dict[int, Pose]) -> NDArray[np.float64]:
    return np.array([(poses[step].x, poses[step].y, poses[step].heading) for step in sorted(poses)]).reshape(-1, 3)


def _true_view(log: EpisodeLog, step: int) -> tuple[NDArray[np.uint8] | None, str]:
    """Return the seeker's view at a step, as people see it, or its last one where the game was over by then, and a caption."""
    shown = min(step, log.steps)
    pose, depth, color = log.poses["seeker"].get(shown), log.depths["seeker"].get(shown), log.colors["seeker"].get(shown)
    if pose is None or depth is None or color is None:
        return None, ""
    image = view_palette("seeker")[perceive(depth, color, pose, "seeker").image]
    caught = log.episode.caught_step is not None and step >= log.episode.caught_step
    return image, f"step {shown}: caught" if caught else f"step {shown}: free"


def _views_of(request: PredictRequest, reply: PredictReply) -> dict[int, tuple[NDArray[np.uint8], float]]:
    caught = np.frombuffer(reply.caught, np.float32).reshape(request.path_count, len(request.horizons))
    shape = (STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, 3)
    return {
        request.step + request.horizons[horizon]: (np.frombuffer(view, np.uint8).reshape(shape), float(caught[path, horizon]))
        for (path, horizon), view in zip(request.views, reply.views, strict=False)
    }
