"""Figures: which games are shown, who is which colour, how large they are on disk, what charts say of their numbers."""

import json
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from learning.dataset import Dataset
from learning.figures import charts, games, maps
from learning.figures.command import CAPTIONS
from learning.figures.style import METHODS, TITLES, VIEW_LEGEND, arena, new_figure, robot, save, show_image
from learning.methods.table import METHODS as METHOD_TABLE
from learning.reproduce.tables import Findings, table_two
from learning.value_maps.play import BEST, OUTCOMES, UNIFORM
from learning.value_maps.report import ANOTHER, ONE_SIMULATION
from tests.learning.made_weights import play_dataset
from vantage.perception.palette import OTHER, OWN, view_for_people, view_palette
from vantage.world.arena import ROBOT_COLORS
from vantage.world.layout import make_layout

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return play_dataset(tmp_path_factory.mktemp("figures"), steps=40)


def test_every_method_has_a_colour_and_a_name_of_its_own() -> None:
    compared = set(METHOD_TABLE) - {"vpn-on-true"}
    assert set(METHODS) == set(TITLES) == compared
    assert len(set(METHODS.values())) == len(set(TITLES.values())) == len(compared)


def colors_of(path: Path) -> Counter[tuple[int, ...]]:
    """Return how often each RGB is in a picture."""
    image = Image.open(path)
    assert image.mode == "RGB"
    return Counter(map(tuple, np.asarray(image).reshape(-1, 3).tolist()))


def test_a_saved_figure_has_the_colours_that_its_legend_names_whatever_else_it_shows(tmp_path: Path) -> None:
    """A palette of 256 made every seeker purple: few pixels are of its colour."""
    blurred = np.random.default_rng(0).integers(0, 256, (380, 380, 3), dtype=np.uint8)
    figure = new_figure(5.0, "noise", width=8.0, views=True)
    show_image(figure.add_axes((0, 0.2, 0.6, 0.8)), blurred)
    axes = figure.add_axes((0.7, 0.3, 0.3, 0.48))
    arena(axes, ())
    for who, x in (("hider", 0.3), ("seeker", 0.9)):
        robot(axes, who, x, 0.6, 0.0)  # type: ignore[arg-type]
    save(figure, tmp_path / "noise.png")
    found = colors_of(tmp_path / "noise.png")
    swatch = 12 * 12
    for name, color in VIEW_LEGEND:
        disc = 300 if name in ROBOT_COLORS else 0
        assert found[tuple(round(255 * part) for part in color)] >= swatch + disc, name
    assert [dict(VIEW_LEGEND)[name] for name in ROBOT_COLORS] == [
        tuple(c / 255 for c in color) for color in ROBOT_COLORS.values()
    ]


def test_a_true_seeker_view_in_a_figure_shows_both_robots_in_their_own_colours(tmp_path: Path) -> None:
    indices = np.ones((128, 128), np.uint8)
    indices[:40, :40], indices[80:, 80:] = OWN, OTHER
    figure = new_figure(4.0, "a view", width=4.0)
    show_image(figure.add_axes((0, 0, 1, 0.9)), view_palette("seeker")[indices])
    save(figure, tmp_path / "view.png")
    found = colors_of(tmp_path / "view.png")
    assert found[ROBOT_COLORS["seeker"]] > 5000 and found[ROBOT_COLORS["hider"]] > 5000
    assert found[255, 0, 0] == found[0, 255, 0] == 0


def drawn_from(dataset: Dataset, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "vantage.cli", "figures", "--data", str(dataset.folder), "--weights", str(folder / "none")]
    return subprocess.run(
        [*command, "--results", str(folder / "none"), "--to", str(folder), *words], capture_output=True, text=True
    )


def test_figures_that_are_there_are_replaced_only_when_asked(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "training-pairs.png").write_text("somebody's")
    refused = drawn_from(dataset, tmp_path)
    assert refused.returncode == 1 and "--force" in refused.stderr and "Traceback" not in refused.stderr
    assert (tmp_path / "training-pairs.png").read_text() == "somebody's"
    forced = drawn_from(dataset, tmp_path, "--force")
    assert forced.returncode == 0, forced.stderr
    assert Image.open(tmp_path / "training-pairs.png").mode == "RGB"
    assert json.loads((tmp_path / "figures.json").read_text())["figures"].keys() == {"training-pairs.png"}


def test_stopped_it_keeps_finished_figures_and_nothing_half(dataset: Dataset, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "vantage.cli", "figures", "--data", str(dataset.folder), "--weights", str(tmp_path / "none")]
    command += ["--results", str(DOCS / "results"), "--to", str(tmp_path / "to")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as drawing:
        assert drawing.stdout is not None
        assert drawing.stdout.readline().endswith("training-pairs.png\n")
        drawing.send_signal(signal.SIGINT)
        said, complaints = drawing.communicate()
    finished = ["training-pairs.png", *(Path(line).name for line in said.splitlines())]
    assert "Traceback" not in complaints
    if drawing.returncode:  # else it was done already
        assert drawing.returncode == 130
        assert "figures: stopped; finished figures are kept" in complaints.splitlines()[-1]
        assert not (tmp_path / "to/figures.json").exists()
    for path in (tmp_path / "to").iterdir():
        assert not path.name.startswith("."), "nothing half"
        if path.suffix == ".png":
            Image.open(path).load()
    assert {path.name for path in (tmp_path / "to").glob("*.png")} >= set(finished)


def test_shown_games_are_test_games_with_their_own_boxes_and_poses(dataset: Dataset) -> None:
    shown = games.chosen_games(dataset)
    test = set(dataset.of_split("test").tolist())
    assert 1 <= len(shown) <= 2 and {game.row for game in shown} <= test
    for game in shown:
        episode = dataset.episodes[game.row]
        assert game.boxes == make_layout("random", int(episode["seed"]))
        first = dataset.steps[episode["first_step"]]
        assert game.poses[0, 0].tolist() == list(first["hider"].item()) and game.poses[1, 0].tolist() == list(
            first["seeker"].item()
        )
        assert (game.caught is None) == (episode["caught_step"] < 0)
        if game.caught is not None:
            assert game.poses.shape[1] == game.caught + 1 and game.at(10**6) == game.caught


def test_the_true_views_are_those_of_the_training_set(dataset: Dataset) -> None:
    game = games.chosen_games(dataset)[0]
    steps = games.every_interval(game)
    assert steps.tolist() == [19, 39]
    rendered = dataset.render(games.samples_of(game, steps))
    np.testing.assert_array_equal(games.seeker_views(dataset, game, steps), view_for_people(rendered.targets, "seeker"))
    np.testing.assert_array_equal(games.samples_of(game, steps).caught, dataset.caught(rendered.samples.episode, steps))


def test_training_pairs_are_drawn(dataset: Dataset) -> None:
    assert len(games.training_pairs(dataset).axes) == 12


def found(value: float, **more: object) -> dict[str, object]:
    return {"mean": value, "sd": 0.1, "interval 95 %": [value - 0.05, value + 0.05], "starts": 3, **more}


def ranking_report() -> dict[str, object]:
    measures = {"with_ties": 0.7, "without_ties": 0.8, "ties_half": 0.8, "tau_b": 0.5}
    names = ("vpt-tob, binary", "vpt-tob, expected", "far from the seeker", ANOTHER)

    def at(shift: float) -> dict[str, object]:
        change = {"change since the first horizon": found(shift)} if shift else {}
        return {ONE_SIMULATION: {n: {m: found(v + shift, **change) for m, v in measures.items()} for n in names}}

    fared = {name: {outcome: found(20.0) for outcome in OUTCOMES} for name in (*names, UNIFORM, BEST)}
    return {
        "horizons": [200, 350],
        "starts": [1, 2, 3],
        "simulations": 20,
        "ranking": {"200": at(0.0), "350": at(-0.02)},
        "play": {"200": fared, "350": fared},
    }


def texts(figure: Figure) -> str:
    inside = [text.get_text() for axes in figure.axes for text in (*axes.get_yticklabels(), *axes.texts, axes.title)]
    return "\n".join([*inside, *(text.get_text() for legend in figure.legends for text in legend.get_texts())])


def test_table_two_stands_beside_the_papers(tmp_path: Path) -> None:
    report = ranking_report()
    (tmp_path / "results").mkdir()
    (tmp_path / "results/maps.json").write_text(json.dumps(report))
    (tmp_path / "results/accuracy.json").write_text(json.dumps({"methods": {}}))
    rows = table_two(Findings(tmp_path), "expected", "with_ties", with_paper=True)
    assert any("75.29 ± 12.23" in row and "72.77 ± 10.82" in row and "-2.52" in row for row in rows)
    assert any("VPT-TOB + VPN" in row and "70.0" in row and "68.0" in row and "-2.0 [-7.0, +3.0]" in row for row in rows)
    figure = charts.table_two(report)
    assert "the paper" in texts(figure) and "VPT-TOB + VPN" in texts(figure) and ANOTHER in texts(figure)
    papers = [line for line in figure.axes[0].lines if line.get_color() == "black"]
    assert [list(line.get_ydata()) for line in papers] == [[75.29, 72.77]]


def test_the_chart_of_play_names_everybody_once() -> None:
    said = texts(charts.play_chart(ranking_report()))
    for name in ("VPT-TOB + VPN", "far from the seeker", ANOTHER, UNIFORM, "the best goal"):
        assert said.splitlines().count(name) == 1, name
    assert "binary" not in said


def test_value_maps_show_danger_and_leave_blocked_goals_white() -> None:
    truth = np.full((1, 1, 121), 5.0, np.float32)
    truth[0, 0, 7] = np.nan
    arrays = {
        "seeds": np.array([3]),
        "horizons": np.array([100]),
        "truth_mean": truth,
        "predictors": np.array(["vpt-tob, binary", "vpt-tob, expected"]),
        "values": np.stack([truth, truth + 2]),
        "chosen": np.array([[[4]], [[9]]]),
        "poses": np.array([[[0.3, 0.3, 0], [0.8, 0.8, 18]]], float),
    }
    figure = maps.value_maps(arrays, "random", rows=4)
    pictures = [image.get_array() for axes in figure.axes for image in axes.images if image.get_array().shape == (11, 11)]
    assert [float(picture.max()) for picture in pictures] == [5.0, 7.0]  # checkpoints at which it is caught: truth, `expected`
    assert figure.axes[-1].get_ylabel().startswith("danger")
    assert all(picture.mask.ravel().nonzero()[0].tolist() == [7] for picture in pictures)


def test_every_caption_ends_as_a_sentence() -> None:
    assert all(caption.endswith(".") and caption[0].isupper() for caption in CAPTIONS.values())
