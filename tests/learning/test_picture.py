"""The demo's picture is drawn from a log alone."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from msgspec.structs import replace

from learning.collect import CollectSettings, play_block
from learning.demo import views_request
from learning.picture import _true_view, draw, draw_value_map, read_game
from schemas import Plan, PredictReply, PredictRequest, StateImage, encode
from vantage.log import LogWriter, read
from vantage.perception.palette import view_for_people, view_palette
from vantage.world.arena import ROBOT_COLORS


def game_with_predictions(folder: Path) -> Path:
    """A real game's log, with a question for predicted views and an answer of plain colours behind it."""
    played, path = folder / "played.mcap", folder / "game.mcap"
    settings = CollectSettings(games=1, hider="goal-walk", to=folder, views=True, steps=60)
    play_block(settings, range(3, 4), played)
    records = list(read(played))
    decoded = [record.decode() for record in records]
    view = next(message for message in decoded if isinstance(message, StateImage))
    plan = next(message for message in decoded if isinstance(message, Plan))
    request = views_request(view, plan)
    assert request.horizons == (19, 39, 59)
    reply = PredictReply(
        stamp=1,
        caught=np.array([0.1, 0.5, 0.9], np.float32).tobytes(),
        views=tuple(bytes([shade] * 128 * 128 * 3) for shade in (10, 120, 230)),
    )
    with LogWriter(path, {}, sync=False) as writer:
        for record in records:
            writer.write(
                record.key,
                record.payload,
                log_time=record.log_time,
                publish_time=record.publish_time,
                sequence=record.sequence,
                publisher=record.publisher,
            )
        for number, (key, message) in enumerate((("predictor/request", request), ("predictor/reply", reply))):
            time = records[-1].log_time + 1 + number
            writer.write(key, encode(message), log_time=time, publish_time=time, sequence=0, publisher="predictor")
    return path


def test_the_game_is_read_with_its_predicted_views(tmp_path: Path) -> None:
    game = read_game(game_with_predictions(tmp_path))
    assert sorted(game.predicted) == [19, 39, 59]
    assert [round(caught, 1) for _, caught in game.predicted.values()] == [0.1, 0.5, 0.9]
    assert [int(view[0, 0, 0]) for view, _ in game.predicted.values()] == [10, 120, 230]


def test_the_picture_shows_something(tmp_path: Path) -> None:
    draw(read_game(game_with_predictions(tmp_path)), tmp_path / "picture.png")
    picture = imread(tmp_path / "picture.png")
    assert picture.shape[:2] == (1240, 1300)
    assert (picture[..., :3] < 0.99).any(axis=2).mean() > 0.1
    centres = []
    for shade in (10, 120, 230):
        shown = view_for_people(np.full(3, shade, np.uint8), "seeker")
        rows, columns = np.nonzero((np.abs(picture[..., :3] - shown / 255) < 1e-3).all(axis=2))
        assert len(rows) > 5000, "each predicted view is there"
        centres.append((columns.mean(), rows.mean()))
    assert [x for x, _ in centres] == sorted(x for x, _ in centres), "from the first step to the last"
    assert all(700 < y < 1000 for _, y in centres), "predictions above, as the label says, and true views below"


def test_robots_goal_and_danger_are_shown_alike_in_all_parts_of_the_picture(tmp_path: Path) -> None:
    game = read_game(game_with_predictions(tmp_path))
    draw(game, tmp_path / "picture.png")
    picture = np.rint(255 * imread(tmp_path / "picture.png")[..., :3]).astype(int)
    for color in ROBOT_COLORS.values():
        assert (picture == color).all(axis=2)[:800].sum() > 1000, "the disc in the arena"
        assert (picture == color).all(axis=2)[-30:].sum() > 100, "the legend"
    for network_color in ((255, 0, 0), (0, 255, 0)):
        assert not (picture == network_color).all(axis=2).any()
    assert (picture == ROBOT_COLORS["seeker"]).all(axis=2)[1000:-30].sum() > 100, "its own disc in its true views"
    figure = Figure()
    axes = figure.add_subplot()
    ((step, plan),) = game.log.plans.items()
    game.log.plans[step] = replace(plan, values=tuple(map(float, range(121))), goal=112)
    draw_value_map(axes, game.log)
    assert "goal (0.30, 1.10) m" in axes.get_xlabel()
    (image,) = axes.images
    assert image.get_array()[0, 0] == 0.0 and image.get_array()[10, 10] == 120.0
    assert image.get_cmap()(0.0)[2] > image.get_cmap()(0.0)[0] and image.get_cmap()(1.0)[0] > image.get_cmap()(1.0)[2], (
        "red is high"
    )
    assert "danger" in figure.axes[1].get_ylabel()


def test_the_true_views_are_what_the_seeker_perceived_frozen_at_the_end(tmp_path: Path) -> None:
    game = read_game(game_with_predictions(tmp_path))
    for step, message in game.log.views["seeker"].items():
        view, _ = _true_view(game.log, step)
        np.testing.assert_array_equal(view, view_palette("seeker")[np.frombuffer(message.data, np.uint8).reshape(128, 128)])
    last, caption = _true_view(game.log, game.log.steps + 50)
    np.testing.assert_array_equal(last, _true_view(game.log, game.log.steps)[0])
    assert caption == f"step {game.log.steps}: {'caught' if game.log.episode.outcome == 'caught' else 'free'}"


def test_a_log_without_a_game_is_a_clear_error(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "empty.mcap", {}, sync=False):
        pass
    with pytest.raises(ValueError, match="holds no game"):
        read_game(tmp_path / "empty.mcap")


def test_the_question_for_views_stays_inside_the_plan() -> None:
    view = StateImage(stamp=1, data=bytes(128 * 128))
    plan = Plan(stamp=1, horizon=7, path=np.zeros((8, 3), np.float32).tobytes())
    request = views_request(view, plan)
    assert isinstance(request, PredictRequest)
    assert request.horizons == (6,) and request.path_steps == 7
