"""The LeRobot data set, read with pyarrow and pillow; `python -m tests.log.readers` reads it with LeRobot's own loader."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as parquet
import pytest
from msgspec import structs
from PIL import Image

from schemas import PRIMITIVES, Command, Episode, Rules, Tick, encode
from services.recorder.appearance import arena_appearance
from tests.log.exporting import PERSON, discard, real_log, write
from tests.log.making import game, records_of
from vantage.log import open_log, read
from vantage.log.episodes import games_of
from vantage.log.export_formats import export_to
from vantage.log.lerobot_features import Choice
from vantage.log.lerobot_statistics import Histogram, Total, of_rows
from vantage.log.target import ExportError
from vantage.perception.palette import PALETTE

LOOKS = arena_appearance()
EVERYTHING = Choice(seeker_pictures=True, without_catching=True)


def frames_of(folder: Path) -> list[dict[str, Any]]:
    return [row for path in sorted(folder.glob("data/*/*.parquet")) for row in parquet.read_table(path).to_pylist()]


def episodes_of(folder: Path) -> list[dict[str, Any]]:
    return parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()


def pixels(cell: dict[str, Any]) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(cell["bytes"])))


def test_every_frame_is_the_logs(tmp_path: Path) -> None:
    export_to("lerobot", real_log(), tmp_path / "set", LOOKS, choice=EVERYTHING)
    frames = iter(frames_of(tmp_path / "set"))
    index = 0
    with open_log(real_log()) as log:
        for number, log_game in enumerate(games_of(log)):
            start = log_game.colors["hider"][0].stamp
            for step in range(log_game.steps):
                frame = next(frames)
                for robot, place in (("hider", "observation"), ("seeker", "privileged")):
                    color, depth, view = (held[robot][step] for held in (log_game.colors, log_game.depths, log_game.views))  # type: ignore[index]
                    assert pixels(frame[f"{place}.images.{robot}_color"]).tobytes() == color.data
                    assert np.array(frame[f"{place}.depth.{robot}"], "<u2").tobytes() == depth.data
                    seen = PALETTE[np.frombuffer(view.data, np.uint8).reshape(128, 128)]
                    assert np.array_equal(pixels(frame[f"{place}.images.{robot}_view"]), seen)
                pose = log_game.poses["hider"][step]
                assert frame["observation.state"] == pytest.approx((pose.x, pose.y, pose.heading), abs=1e-6)
                command = log_game.commands["hider"][step]
                assert frame["action"] == [float(name == command.primitive) for name in PRIMITIVES]
                stamp = log_game.colors["hider"][step].stamp
                assert frame["capture_time_ns"] == stamp
                assert frame["timestamp"] == pytest.approx((stamp - start) / 1e9, abs=1e-5)
                assert (frame["frame_index"], frame["episode_index"], frame["index"]) == (step, number, index)
                assert frame["next.done"] == (step == log_game.steps - 1)
                index += 1
    assert next(frames, None) is None
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert (info["codebase_version"], info["total_frames"], info["total_episodes"], info["fps"]) == ("v3.0", index, number + 1, 4)


def test_episodes_begin_and_end_with_their_own_frames(tmp_path: Path) -> None:
    export_to("lerobot", real_log(), tmp_path / "set", LOOKS, choice=EVERYTHING)
    frames = frames_of(tmp_path / "set")
    end = 0
    for number, episode in enumerate(episodes_of(tmp_path / "set")):
        assert episode["dataset_from_index"] == end
        end = episode["dataset_to_index"]
        own = frames[episode["dataset_from_index"] : end]
        assert {frame["episode_index"] for frame in own} == {number}
        assert [frame["frame_index"] for frame in own] == list(range(episode["length"]))
        assert own[0]["timestamp"] == 0.0
        assert [frame["next.done"] for frame in own] == [False] * (len(own) - 1) + [True]
    assert end == len(frames)


def test_statistics_of_an_episode_are_those_of_its_own_frames(tmp_path: Path) -> None:
    export_to("lerobot", real_log(), tmp_path / "set", LOOKS, choice=EVERYTHING)
    frames = frames_of(tmp_path / "set")
    for episode in episodes_of(tmp_path / "set"):
        own = frames[episode["dataset_from_index"] : episode["dataset_to_index"]]
        color = np.stack([pixels(frame["observation.images.hider_color"]) for frame in own]) / 255
        depth = np.array([frame["observation.depth.hider"] for frame in own])
        pose = np.array([frame["observation.state"] for frame in own])
        for name, mean in (
            ("observation.images.hider_color", color.mean((0, 1, 2))),
            ("observation.depth.hider", depth.mean()),
            ("observation.state", pose.mean(0)),
        ):
            assert episode[f"stats/{name}/count"] == [len(own)]
            assert np.ravel(episode[f"stats/{name}/mean"]) == pytest.approx(np.ravel(mean), rel=1e-5)


def test_the_persons_name_does_not_go_in(tmp_path: Path) -> None:
    export_to("lerobot", real_log(), tmp_path / "set", LOOKS, choice=EVERYTHING)
    assert {episode["vantage/hider"] for episode in episodes_of(tmp_path / "set")} == {"human"}
    for path in (tmp_path / "set").rglob("*"):
        assert path.is_dir() or PERSON.encode() not in path.read_bytes()


def test_aborted_discarded_and_incomplete_games_are_left_out_and_counted(tmp_path: Path) -> None:
    records = list(read(real_log(5)))
    numbers = sorted({record.decode().episode for record in records})
    kept, aborted, taken_back, torn, unfinished = numbers
    changed = []
    for record in records:
        message = record.decode()
        if isinstance(message, Episode) and message.phase == "ended" and message.episode in (aborted, unfinished):
            if message.episode == unfinished:
                continue
            record = structs.replace(record, payload=encode(structs.replace(message, phase="aborted")))
        if isinstance(message, Command) and (message.episode, message.step) == (torn, 3):
            continue
        changed.append(record)
    write(tmp_path / "log.mcap", [*changed, discard(taken_back, changed[-1])])
    done = export_to("lerobot", tmp_path / "log.mcap", tmp_path / "set", LOOKS, choice=EVERYTHING)
    assert [episode["vantage/game"] for episode in episodes_of(tmp_path / "set")] == [kept]
    assert {line for line in done.said if line.startswith("left out")} == {
        f"left out: 1 game aborted ({aborted})",
        f"left out: 1 game discarded by the player ({taken_back})",
        f"left out: 1 game with messages missing ({torn})",
        f"left out: 1 game not finished in this log ({unfinished})",
    }
    with pytest.raises(ExportError, match="no finished game"):
        export_to("lerobot", tmp_path / "log.mcap", tmp_path / "other", LOOKS, episode=aborted)
    assert not (tmp_path / "other").exists()


def test_what_the_hider_cannot_know_is_no_observation(tmp_path: Path) -> None:
    """As LeRobot's policies choose: every picture, and all numbers whose name begins with `observation` or `action`."""
    write(tmp_path / "log.mcap", records_of(game(1, 4)))
    export_to("lerobot", tmp_path / "log.mcap", tmp_path / "set", LOOKS)
    features = json.loads((tmp_path / "set/meta/info.json").read_text())["features"]
    chosen = {name for name, found in features.items() if found["dtype"] == "image" or name.startswith(("observation", "action"))}
    assert chosen == {"observation.images.hider_color", "observation.depth.hider", "observation.state", "action"}
    assert features.keys() == frames_of(tmp_path / "set")[0].keys()
    assert "seeker_color" not in (tmp_path / "set/README.md").read_text()
    export_to("lerobot", tmp_path / "log.mcap", tmp_path / "all", LOOKS, choice=EVERYTHING)
    found = json.loads((tmp_path / "all/meta/info.json").read_text())["features"]
    assert not [name for name in found if "seeker" in name and not name.startswith("privileged.")]
    assert "seeker_color" in (tmp_path / "all/README.md").read_text()


def test_surviving_without_catching_is_no_success_and_not_there_unless_asked_for(tmp_path: Path) -> None:
    uncatchable = [
        (key, structs.replace(message, rules=Rules(catching=False)) if isinstance(message, Episode) else message)
        for key, message in game(2, 3)
    ]
    write(tmp_path / "log.mcap", records_of([*game(1, 4), *uncatchable]))
    done = export_to("lerobot", tmp_path / "log.mcap", tmp_path / "set", LOOKS)
    assert [episode["vantage/game"] for episode in episodes_of(tmp_path / "set")] == [1]
    assert "left out: 1 game without catching, see --without-catching (2)" in done.said
    export_to("lerobot", tmp_path / "log.mcap", tmp_path / "both", LOOKS, choice=EVERYTHING)
    found = episodes_of(tmp_path / "both")
    assert [(episode["vantage/game"], episode["vantage/catching"]) for episode in found] == [(1, True), (2, False)]
    assert [frame["next.success"] for frame in frames_of(tmp_path / "both")] == [False] * 3 + [True] + [False] * 3
    assert "In 1 of the games catches were ignored" in (tmp_path / "both/README.md").read_text()
    assert "catches were ignored" not in (tmp_path / "set/README.md").read_text()


def test_games_of_several_rates_are_refused_and_chosen_by_rate(tmp_path: Path) -> None:
    fast = [
        (key, structs.replace(message, rules=Rules(step_period=0.05)) if isinstance(message, Episode) else message)
        for number in (2, 3)
        for key, message in game(number, 3)
    ]
    write(tmp_path / "log.mcap", records_of([*game(1, 4), *fast]))
    with pytest.raises(ExportError, match=r"\(4 Hz: 1; 20 Hz: 2, 3\): choose with --rate, or one --game"):
        export_to("lerobot", tmp_path / "log.mcap", tmp_path / "set", LOOKS)
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]
    for rate, numbers, left_out in ((4.0, [1], "2 games of another rate than 4 Hz (2, 3)"), (20.0, [2, 3], "1 game of another")):
        folder = tmp_path / f"{rate:g}"
        done = export_to("lerobot", tmp_path / "log.mcap", folder, LOOKS, choice=Choice(rate=rate))
        assert [episode["vantage/game"] for episode in episodes_of(folder)] == numbers
        assert any(left_out in line for line in done.said)
    one = export_to("lerobot", tmp_path / "log.mcap", tmp_path / "one", LOOKS, episode=2)
    assert one.said and [episode["vantage/game"] for episode in episodes_of(tmp_path / "one")] == [2]


def test_a_robot_that_was_late_stayed(tmp_path: Path) -> None:
    messages = []
    for key, message in game(1, 5):
        if key == "hider/command" and message.step == 2:
            messages.append(("tick", Tick(stamp=message.stamp, episode=1, step=2, late=("hider",))))
            continue
        messages.append((key, message))
    write(tmp_path / "log.mcap", records_of(messages))
    export_to("lerobot", tmp_path / "log.mcap", tmp_path / "set", LOOKS)
    actions = [PRIMITIVES[int(np.argmax(frame["action"]))] for frame in frames_of(tmp_path / "set")]
    assert actions == ["stay", "forward", "stay", "left", "right"]


def test_true_times_are_kept_also_when_they_are_uneven(tmp_path: Path) -> None:
    messages = []
    for key, message in game(1, 6):
        jitter = message.step**2 * 7_000_000 if key == "hider/color" else 0  # the pictures' own times count, no others
        messages.append((key, structs.replace(message, stamp=message.stamp + jitter)))
    write(tmp_path / "log.mcap", records_of(messages))
    export_to("lerobot", tmp_path / "log.mcap", tmp_path / "set", LOOKS)
    frames = frames_of(tmp_path / "set")
    expected = [0.25 * step + 0.007 * step**2 for step in range(6)]
    assert [frame["timestamp"] for frame in frames] == pytest.approx(expected, abs=1e-6)
    captured = [message.stamp for key, message in messages if key == "hider/color"]
    assert [frame["capture_time_ns"] for frame in frames] == captured[: len(frames)]


def test_a_folder_of_logs_is_one_data_set_and_sizes_must_agree(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    for number in (1, 2):
        write(logs / f"{number}.mcap", records_of(game(number, 4)))
    export_to("lerobot", logs, tmp_path / "set", LOOKS)
    assert [episode["vantage/log"] for episode in episodes_of(tmp_path / "set")] == ["1.mcap", "2.mcap"]
    (logs / "3.mcap").write_bytes(real_log().read_bytes())
    with pytest.raises(ExportError, match="a data set has one size"):
        export_to("lerobot", logs, tmp_path / "mixed", LOOKS, choice=EVERYTHING)
    assert not (tmp_path / "mixed").exists()


def test_statistics_are_those_of_the_numbers() -> None:
    generator = np.random.default_rng(1)
    pictures = [generator.integers(0, 256, (6, 5, 3), dtype=np.uint8) for _ in range(4)]
    histogram = Histogram(3, 256, 255.0, (3, 1, 1))
    for picture in pictures:
        histogram.add(picture)
    stack = np.stack(pictures).reshape(-1, 3) / 255
    found = histogram.statistics()
    assert found["count"] == [4]
    for name, expected in (("min", stack.min(0)), ("max", stack.max(0)), ("mean", stack.mean(0)), ("std", stack.std(0))):
        assert found[name].shape == (3, 1, 1)
        assert found[name].ravel() == pytest.approx(expected, abs=1e-9)
    assert found["q50"].ravel() == pytest.approx(np.quantile(stack, 0.5, axis=0, method="inverted_cdf"))
    rows = generator.normal(3.0, 2.0, (50, 2))
    total = Total()
    for part in (rows[:7], rows[7:20], rows[20:]):
        total.add({"x": of_rows(part)})
    lists = total.as_lists()["x"]
    assert lists["mean"] == pytest.approx(rows.mean(0))
    assert lists["std"] == pytest.approx(rows.std(0))
    assert (lists["min"], lists["max"], lists["count"]) == (rows.min(0).tolist(), rows.max(0).tolist(), [50])
