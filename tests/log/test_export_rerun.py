"""The Rerun recording, read back by rerun-sdk and checked by its own command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from rerun.chunk import RrdReader

from schemas import Episode
from services.recorder.appearance import arena_appearance
from tests.log.exporting import PERSON, real_log, write
from tests.log.making import START, game, records_of
from vantage.log import read
from vantage.log.export_formats import export_to

LOOKS = arena_appearance()
RERUN = Path(sys.executable).parent / "rerun"


def rows_of(path: Path) -> dict[str, int]:
    """Entity -> rows that are not static, as Rerun's own statistics print them."""
    counts: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        if not chunk.is_static:
            counts[str(chunk.entity_path)] = counts.get(str(chunk.entity_path), 0) + chunk.num_rows
    return counts


def times_of(path: Path, entity: str) -> dict[str, list[int]]:
    """Timeline -> where on it an entity's rows are, in order: steps, or ns."""
    from rerun.chunk import RrdReader

    times: dict[str, list[int]] = {"step": [], "recorded": [], "captured": []}
    for chunk in RrdReader(path).stream():
        if str(chunk.entity_path) == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            for name, found in times.items():
                found += batch.column(batch.schema.get_field_index(name)).cast("int64").to_pylist()
    return {name: sorted(found) for name, found in times.items()}


def test_every_message_of_the_game_is_in_the_recording(tmp_path: Path) -> None:
    export_to("rerun", real_log(), tmp_path / "two.rrd", LOOKS, episode=2)
    messages: dict[str, int] = {}
    for record in read(real_log()):
        if record.decode().episode == 2:
            messages[record.key] = messages.get(record.key, 0) + 1
    rows = rows_of(tmp_path / "two.rrd")
    for robot in ("hider", "seeker"):
        assert rows[f"/arena/{robot}"] == messages[f"{robot}/pose"]
        assert rows[f"/arena/{robot}/camera/picture/color"] == messages[f"{robot}/color"]
        assert rows[f"/arena/{robot}/camera/picture/depth"] == messages[f"{robot}/depth"]
        assert rows[f"/views/{robot}"] == messages[f"{robot}/view"]
    assert rows["/value-map"] == messages["hider/plan"]
    assert rows["/predicted-views"] == messages["predictor/reply"]
    assert rows["/text"] == messages["episode"]
    checked = subprocess.run([RERUN, "rrd", "verify", tmp_path / "two.rrd"], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stderr
    assert PERSON.encode() not in (tmp_path / "two.rrd").read_bytes()


def test_every_timeline_says_its_own_time(tmp_path: Path) -> None:
    export_to("rerun", real_log(), tmp_path / "two.rrd", LOOKS, episode=2)
    records = [record for record in read(real_log(), topics=("hider/command",)) if record.decode().episode == 2]
    expected = {
        "step": [record.decode().step for record in records],
        "recorded": [record.log_time for record in records],
        "captured": [record.decode().stamp for record in records],
    }
    assert len({tuple(times) for times in (*expected.values(), [record.publish_time for record in records])}) == 4
    assert times_of(tmp_path / "two.rrd", "/commands/hider") == expected


def test_of_a_game_that_overlaps_in_time_nothing_goes_in(tmp_path: Path) -> None:
    records = records_of(game(1, 4)) + records_of(game(2, 4), start=START + 500_000)
    write(tmp_path / "log.mcap", sorted(records, key=lambda record: record.log_time))
    for number in (1, 2):
        export_to("rerun", tmp_path / "log.mcap", tmp_path / f"{number}.rrd", LOOKS, episode=number)
        assert times_of(tmp_path / f"{number}.rrd", "/arena/hider")["step"] == list(range(5))


def test_several_games_are_several_files(tmp_path: Path) -> None:
    done = export_to("rerun", real_log(), tmp_path / "all", LOOKS)
    numbers = [record.decode().episode for record in read(real_log(), topics=("episode",)) if is_set_up(record.decode())]
    assert sorted(path.name for path in (tmp_path / "all").iterdir()) == [f"game-{number:04d}.rrd" for number in numbers]
    assert len(done.said) == len(numbers)


def is_set_up(message: object) -> bool:
    return isinstance(message, Episode) and message.phase == "setup"
