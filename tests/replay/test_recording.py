"""Finding a moment in a log on disk: in parts, cut short, compressed in chunks; against a look at every record."""

from __future__ import annotations

import struct
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import Writer

from schemas import Message, PredictRequest
from tests.replay.games import MALFORMED, MILLISECOND, ListedSource, game, recorded
from vantage.log import LogWriter, Record
from vantage.log.reader import find_logs
from vantage.replay.recording import Recording, find_parts
from vantage.replay.trouble import ReplayError

GAMES = [message for number in (1, 2, 3) for message in game(number, 10 + number, 12, "ended")]


def write(path: Path, records: list[Record], chunk_size: int = 2000, split_bytes: int | None = None) -> list[Record]:
    with LogWriter(path, {}, sync=False, chunk_size=chunk_size, split_bytes=split_bytes) as log:
        for record in records:
            log.write(
                record.key,
                record.payload,
                log_time=record.log_time,
                publish_time=record.publish_time,
                sequence=record.sequence,
                publisher=record.publisher,
                well_formed=record.well_formed,
            )
    return records


def made(said: list[tuple[str, Message]] = GAMES, gap: int = 20 * MILLISECOND) -> list[Record]:
    return recorded(said, [gap, 1000])


@pytest.mark.parametrize("split", [None, 6000], ids=["one file", "parts"])
def test_every_moment_is_found_as_in_the_whole_log(tmp_path: Path, split: int | None) -> None:
    records = write(tmp_path / "run.mcap", made(), split_bytes=split)
    parts = find_parts(tmp_path)
    assert (len(parts) > 2) == (split is not None)
    recording, listed = Recording(*parts), ListedSource(records)
    assert (recording.start, recording.end) == (listed.start, listed.end)
    assert [(game.number, game.start, len(game.words)) for game in recording.games] == [
        (game.number, game.start, len(game.words)) for game in listed.games
    ]
    moments = {time + shift for record in records for time in [record.log_time] for shift in (-1, 0, 1)}
    for moment in sorted(moments)[::3]:
        assert recording.latest(moment) == listed.latest(moment)
        assert list(recording.records(moment)) == list(listed.records(moment))
    recording.close()


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_pictures_in_chunks_of_their_own_are_found_as_well(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Bulky messages lie in other chunks than small ones, which overlap in time."""
    keys = st.sampled_from(["tick", "hider/pose", "hider/color", "seeker/color"])
    sizes = st.sampled_from([20, 200, 40_000])
    said = data.draw(st.lists(st.tuples(keys, sizes), min_size=1, max_size=30))
    records = recorded([(key, bytes(size)) for key, size in said], [data.draw(st.integers(1, 3 * 10**8))])
    folder = tmp_path_factory.mktemp("log")
    write(folder / "run.mcap", records, chunk_size=data.draw(st.sampled_from([100, 50_000])))
    recording, listed = Recording(*find_parts(folder)), ListedSource(records)
    for record in records:
        assert recording.latest(record.log_time) == listed.latest(record.log_time)
        assert list(recording.records(record.log_time)) == list(listed.records(record.log_time))
    recording.close()


def test_of_a_log_cut_short_what_is_whole_is_found(tmp_path: Path) -> None:
    records = write(tmp_path / "run.mcap", made())
    whole = (tmp_path / "run.mcap").read_bytes()
    for kept in range(len(whole) // 2, len(whole), len(whole) // 40):
        path = tmp_path / f"cut-{kept}.mcap"
        path.write_bytes(whole[:kept])
        recording = Recording(path)
        got = list(recording.records(recording.start - 1))
        assert recording.breaks and got == records[: len(got)] and got
        assert recording.latest(recording.end) == ListedSource(got).latest(recording.end)
        assert (recording.start, recording.end) == (got[0].log_time, got[-1].log_time)
        recording.close()


def test_another_programs_log_cut_short_is_played_as_far_as_it_can_be_read(tmp_path: Path) -> None:
    """It describes channels within its chunks, and repeats them in a summary that is cut off."""
    records = made()
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000)
        writer.start()
        schema = writer.register_schema("message", "jsonschema", b"{}")
        ids: dict[str, int] = {}
        for record in records:
            if record.key not in ids:
                about = {"publisher": record.publisher}
                ids[record.key] = writer.register_channel(record.key, "msgpack", schema, about)
            writer.add_message(ids[record.key], record.log_time, record.payload, record.publish_time, record.sequence % 2**32)
        writer.finish()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 7 // 10])
    recording = Recording(path)
    got = list(recording.records(-1))
    assert len(records) > len(got) > len(records) // 2 and got == records[: len(got)]
    assert (recording.start, recording.end) == (got[0].log_time, got[-1].log_time)
    assert recording.latest(recording.end) == ListedSource(got).latest(recording.end)
    assert [each.number for each in recording.games][:2] == [1, 2] and ("tick", "referee") in recording.publishers
    recording.close()


def test_an_empty_chunk_is_no_beginning(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap", made())
    data = (tmp_path / "run.mcap").read_bytes()
    at = 8
    while data[at] != Opcode.CHUNK:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    empty = struct.pack("<QQQIIQ", 0, 0, 0, 0, 0, 0)
    (tmp_path / "run.mcap").write_bytes(data[:at] + struct.pack("<BQ", Opcode.CHUNK, len(empty)) + empty + data[at:])
    recording = Recording(tmp_path / "run.mcap")
    assert recording.start == made()[0].log_time
    recording.close()


def test_a_number_that_is_set_up_again_is_another_game() -> None:
    said = game(1, 5, 3, "ended") + game(1, 9, 3, "ended")
    source = ListedSource(made(said))
    assert [(each.number, each.words[0].said.seed) for each in source.games] == [(1, 5), (1, 9)]
    assert source.games[0].words[-1].time <= source.games[1].since < source.games[1].start


def test_what_run_names_is_found_or_said_not_to_be(tmp_path: Path) -> None:
    with pytest.raises(ReplayError, match="no such log or folder"):
        find_parts(tmp_path / "nothing.mcap")
    with pytest.raises(ReplayError, match="no log"):
        find_parts(tmp_path)
    write(tmp_path / "run.mcap", made(), split_bytes=6000)
    (parts,) = find_logs(tmp_path)
    assert find_parts(parts[0]) == parts == find_parts(tmp_path)
    with pytest.raises(ReplayError, match=f"is part 2 of a log: name its first part, {parts[0]}"):
        find_parts(parts[1])
    write(tmp_path / "another.mcap", made())
    with pytest.raises(ReplayError, match="holds 2 logs") as said:
        find_parts(tmp_path)
    assert "another.mcap" in str(said.value) and "run_000.mcap" in str(said.value)


def test_what_holds_nothing_is_said(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("no log at all, but some text")
    with pytest.raises(ReplayError, match=r"text\.mcap: nothing to replay: .*not an MCAP file"):
        Recording(tmp_path / "text.mcap")
    write(tmp_path / "empty.mcap", [])
    with pytest.raises(ReplayError, match="it holds no message"):
        Recording(tmp_path / "empty.mcap")


def test_the_planners_question_is_found_behind_a_viewers(tmp_path: Path) -> None:
    """A page asks the predictor about single goals; who joins after a jump needs what the planner asked about all of them."""
    question = PredictRequest(
        stamp=1, episode=1, state_image=bytes(128 * 128), path_count=1, path_steps=2, paths=bytes(16), horizons=(1,)
    )
    of_viewer = msgspec.structs.replace(question, views=((0, 0),))
    write(tmp_path / "run.mcap", made([("predictor/request", question), ("predictor/request", of_viewer), *game(1, 1, 3, "")]))
    recording = Recording(*find_parts(tmp_path))
    assert recording.latest(recording.end)["predictor/request"].decode() == question
    recording.close()


def test_a_malformed_message_does_not_hide_the_one_before(tmp_path: Path) -> None:
    records = recorded([*game(1, 5, 2, "ended")[:-1], MALFORMED], [MILLISECOND])
    ticks = [record for record in records if record.key == "tick"]
    assert not ticks[-1].well_formed
    write(tmp_path / "run.mcap", records)
    recording = Recording(tmp_path / "run.mcap")
    assert recording.latest(recording.end)["tick"] == ticks[-2]
    recording.close()
