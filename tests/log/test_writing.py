"""What is written reads back the same, here and with mcap's own reader."""

from __future__ import annotations

import json
import random
import struct
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Literal

import msgpack
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from schemas import TOPICS, Layout, Pose, encode
from tests.log.making import START, game, records_of, write_log, write_record
from vantage.log import LogWriter, Record, RunMetadata, find_logs, open_log, read
from vantage.log.reader import NoSuchLog

Compression = Literal["zstd", "lz4", "none"]
every_compression = pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])


@every_compression
def test_round_trip(tmp_path: Path, compression: Compression) -> None:
    records = records_of(game(1, 40))
    write_log(tmp_path / "log.mcap", records, compression=compression)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert list(read(tmp_path / "log.mcap")) == records
        assert list(read(tmp_path / "log.mcap", topics={"tick", "layout"})) == [r for r in records if r.key in ("tick", "layout")]


@every_compression
@pytest.mark.parametrize("chunk_size", [1, 3000, 1 << 20])
def test_the_stock_reader_agrees(tmp_path: Path, compression: Compression, chunk_size: int) -> None:
    records = records_of(game(1, 30))
    path = tmp_path / "log.mcap"
    write_log(path, records, compression=compression, chunk_size=chunk_size)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(records)
        assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (
            records[0].log_time,
            records[-1].log_time,
        )
        assert [record.name for record in reader.iter_metadata()] == ["vantage"]
        read_back = []
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert schema.encoding == "jsonschema"
            assert schema.name == TOPICS[channel.topic].type.__name__
            assert channel.message_encoding == "msgpack"
            assert set(json.loads(schema.data)["properties"]) >= set(msgpack.unpackb(message.data))
            publisher = channel.metadata["publisher"]
            read_back.append(
                Record(channel.topic, publisher, message.sequence, message.log_time, message.publish_time, message.data)
            )
        assert read_back == records
        window = [m.log_time for _, _, m in reader.iter_messages(topics=["hider/pose"], starting_at=records[100].log_time)]
        assert window == [r.log_time for r in records[100:] if r.key == "hider/pose"]
    first = next(r for r in StreamReader(str(path), validate_crcs=True).records if type(r).__name__ != "Header")
    assert type(first).__name__ == "Metadata"


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    written=st.lists(
        st.tuples(
            st.sampled_from([*list(TOPICS)[:6], "stranger/thing", ""]),
            st.sampled_from(["simulator", "tracker", ""]),
            st.integers(0, 2**32 - 1),
            st.integers(1, 2**63),
            st.integers(0, 2**63),
            st.binary(max_size=50) | st.integers(30_000, 40_000).map(bytes),
            st.booleans(),
        ),
        max_size=30,
    ),
    chunk_size=st.sampled_from([1, 200, 1 << 20]),
    compression=st.sampled_from(["zstd", "lz4", "none"]),
)
def test_anything_reads_back_in_the_order_of_writing(
    tmp_path_factory: pytest.TempPathFactory,
    written: list[tuple[str, str, int, int, int, bytes, bool]],
    chunk_size: int,
    compression: Compression,
) -> None:
    path = tmp_path_factory.mktemp("any") / "log.mcap"
    records = [Record(*row) for row in written]
    write_log(path, records, chunk_size=chunk_size, compression=compression)
    found = list(read(path))
    as_said = [(r.key, r.publisher, r.sequence, r.publish_time, r.payload) for r in records]
    assert [(r.key, r.publisher, r.sequence, r.publish_time, r.payload) for r in found] == as_said
    assert [r.well_formed for r in found] == [r.well_formed and r.key in TOPICS for r in records]
    times = [r.log_time for r in found]
    assert all(earlier < later for earlier, later in pairwise(times))
    assert all(late.log_time >= record.log_time for late, record in zip(found, records, strict=True))
    with path.open("rb") as file:
        assert [m.data for _, _, m in make_reader(file, validate_crcs=True).iter_messages()] == [r.payload for r in records]


def test_times_move_by_no_more_than_the_messages_of_one_instant(tmp_path: Path) -> None:
    pose = encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0))
    times = [100, 100, 100, 50, 200, 200]
    write_log(tmp_path / "log.mcap", [Record("hider/pose", "simulator", n, t, t, pose) for n, t in enumerate(times)])
    assert [r.log_time for r in read(tmp_path / "log.mcap")] == [100, 101, 102, 103, 200, 201]


@pytest.mark.parametrize("options", [{"split_bytes": 20_000, "chunk_size": 2000}, {"split_seconds": 0.1}], ids=["size", "time"])
def test_parts_stand_alone_and_read_as_one(tmp_path: Path, options: dict[str, float]) -> None:
    records = records_of(game(1, 60))
    write_log(tmp_path / "run.mcap", records, **options)
    parts = sorted(tmp_path.iterdir())
    assert len(parts) > 3
    assert [part.name for part in parts] == [f"run_{n:03d}.mcap" for n in range(len(parts))]
    assert list(read(tmp_path)) == records
    assert find_logs(tmp_path) == [parts]
    for number, part in enumerate(parts):
        with part.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            metadata = next(reader.iter_metadata()).metadata
            assert (metadata["commit"], metadata["part"]) == ("test", str(number))
            topics = {channel.topic for _, channel, _ in reader.iter_messages()}
        # Each part alone knows the arena, the game and the plan.
        assert {"layout", "episode", "hider/plan"} <= topics
        alone = [r for r in read(part) if r.key == "layout"]
        assert [r.payload for r in alone] == [r.payload for r in records if r.key == "layout"]
        if options.get("split_bytes"):
            assert part.stat().st_size < 20_000 + 2 * 2000 + 40_000


def test_the_next_part_is_open_before_the_last_is_closed(tmp_path: Path) -> None:
    records = records_of(game(1, 20))
    with LogWriter(tmp_path / "run.mcap", RunMetadata(), split_seconds=1000, sync=False) as log:
        for record in records:
            write_record(log, record)
        before = log.part
        log.split()
        assert log.part != before
        assert log.part.stat().st_size > 8
        # All of the first part is in its file, closed.
        with before.open("rb") as file:
            assert sum(1 for _ in make_reader(file).iter_messages()) == len(records)
    assert list(read(tmp_path)) == records


def test_numbered_names_alone_do_not_make_parts(tmp_path: Path) -> None:
    for number in range(3):
        write_log(tmp_path / f"worker_{number:03d}.mcap", records_of(game(number + 1, 3)))
    assert [len(parts) for parts in find_logs(tmp_path)] == [1, 1, 1]
    assert sum(1 for _ in read(tmp_path)) == 3 * len(records_of(game(1, 3)))


def test_a_log_is_never_overwritten(tmp_path: Path) -> None:
    write_log(tmp_path / "log.mcap", [])
    with pytest.raises(FileExistsError):
        LogWriter(tmp_path / "log.mcap", RunMetadata())


def test_an_empty_log_reads(tmp_path: Path) -> None:
    write_log(tmp_path / "log.mcap", [])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert list(read(tmp_path / "log.mcap")) == []
    with (tmp_path / "log.mcap").open("rb") as file:
        assert list(make_reader(file).iter_messages()) == []


def test_no_log_is_said_clearly(tmp_path: Path) -> None:
    with pytest.raises(NoSuchLog, match="no log"):
        list(read(tmp_path))


def test_gaps_are_in_the_log_and_in_its_metadata(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap", RunMetadata(), sync=False) as log:
        log.gap("hider/pose", "simulator", 3, log_time=START)
        log.gap("hider/pose", "simulator", 2, log_time=START + 5)
        log.gap("tick", "referee", 1, log_time=START + 6)
        assert log.gaps == {("hider/pose", "simulator"): 5, ("tick", "referee"): 1}
    notes = [(r.key, r.decode()) for r in read(tmp_path / "log.mcap")]
    assert [(key, note.key, note.publisher, note.missed) for key, note in notes] == [  # type: ignore[attr-defined]
        ("gap", "hider/pose", "simulator", 3),
        ("gap", "hider/pose", "simulator", 2),
        ("gap", "tick", "referee", 1),
    ]
    with open_log(tmp_path / "log.mcap") as log_read:
        assert log_read.gaps == {"hider/pose simulator": 5, "tick referee": 1}


def test_strangers_and_nonsense_are_kept_as_bytes(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap", RunMetadata(), sync=False) as log:
        common = {"log_time": START, "publish_time": 0, "sequence": 0}
        log.write("stranger/thing", b"\x00\x01", publisher="", **common)
        log.write("hider/pose", b"nonsense", publisher="simulator", well_formed=False, **common)
        log.write("hider/pose", encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0)), publisher="simulator", **common)
        assert (log.undeclared, log.malformed) == (1, 1)
    with (tmp_path / "log.mcap").open("rb") as file:
        found = [
            (channel.topic, channel.message_encoding, schema.name if schema else None, message.data)
            for schema, channel, message in make_reader(file).iter_messages()
        ]
    assert found[:2] == [("stranger/thing", "", None, b"\x00\x01"), ("hider/pose", "", None, b"nonsense")]
    assert found[2][:3] == ("hider/pose", "msgpack", "Pose")


def test_any_number_of_strangers_keys_costs_a_bounded_number_of_channels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vantage.log.routes.MOST_CHANNELS", 20)
    pose = encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0))
    with LogWriter(tmp_path / "log.mcap", RunMetadata(), sync=False) as log:
        common = {"log_time": START, "publish_time": 0}
        for number in range(100):
            log.write(f"stranger/{number}", bytes([number]), sequence=0, publisher=f"stranger-{number}", **common)
            log.write("hider/pose", pose, sequence=number, publisher=f"stranger-{number}", **common)
        log.write("hider/pose", pose, sequence=0, publisher="simulator", **common)
    with open_log(tmp_path / "log.mcap") as found:
        records = list(found.records())
        assert len(found.files[0].channels) == 20 + 2
    assert len(records) == 201
    assert (records[-1].key, records[-1].publisher, records[-1].payload) == ("hider/pose", "simulator", pose)
    assert [record.payload for record in records if len(record.payload) == 1] == [bytes([number]) for number in range(100)]


def test_a_time_out_of_range_is_refused_and_spoils_nothing(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap", RunMetadata(), sync=False) as log:
        log.write("stranger/thing", b"good", log_time=START, publish_time=1, sequence=0, publisher="")
        with pytest.raises(struct.error):
            log.write("stranger/thing", b"bad", log_time=START, publish_time=-1, sequence=1, publisher="")
    with (tmp_path / "log.mcap").open("rb") as file:
        assert [message.data for _, _, message in make_reader(file).iter_messages()] == [b"good"]


def test_a_flushed_message_is_in_the_file(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log.mcap", RunMetadata(), flush_period=10**15)
    records = records_of(game(1, 2))
    for record in records:
        write_record(log, record)
    assert list(read(tmp_path / "log.mcap")) == []
    log.flush()
    assert list(read(tmp_path / "log.mcap")) == records
    log.close()
    assert list(read(tmp_path / "log.mcap")) == records


def test_writing_flushes_by_itself(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log.mcap", RunMetadata(), flush_period=0)
    records = records_of(game(1, 2))
    for record in records:
        write_record(log, record)
    assert list(read(tmp_path / "log.mcap")) == records
    log.close()


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_of_other_programs_read(tmp_path: Path, chunked: bool, compression: CompressionType) -> None:
    path = tmp_path / "other.mcap"
    writer = Writer(str(path), chunk_size=500, compression=compression, use_chunking=chunked)
    writer.start()
    channels = [writer.register_channel(key, "msgpack", 0) for key in ("hider/pose", "tick")]
    for number in range(300):
        channel = channels[number % 2]
        writer.add_message(channel, log_time=1000 - number, data=struct.pack("<I", number), publish_time=5, sequence=number)
    writer.finish()
    found = list(read(path))
    assert sorted(struct.unpack("<I", r.payload)[0] for r in found) == list(range(300))
    if chunked:
        assert [r.log_time for r in found] == sorted(r.log_time for r in found)
    assert {r.sequence for r in read(path, topics={"tick"})} == set(range(1, 300, 2))


def test_what_cannot_shrink_is_stored_as_it_is(tmp_path: Path) -> None:
    noise = random.Random(1)
    layout = encode(Layout(stamp=1))
    records = [Record("layout", "simulator", 0, 1, 1, layout)]
    records += [Record("hider/color", "simulator", n, n + 2, 1, noise.randbytes(100_000)) for n in range(30)]
    write_log(tmp_path / "log.mcap", records, chunk_size=100_000)
    with (tmp_path / "log.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        assert [index.compression for index in summary.chunk_indexes].count("") >= 29
    assert list(read(tmp_path / "log.mcap")) == records
