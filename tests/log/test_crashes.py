"""Killed writers, cut and damaged files, full disks: what was written stays readable, and nothing raises."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import warnings
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC

from schemas import Pose, encode
from tests.log.making import START, game, records_of, write_log, write_record
from vantage.log import BrokenLog, LogWriter, Record, RunMetadata, open_log, read
from vantage.log.recover import NothingToRecover, recover
from vantage.log.report import info

QUIET = settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("crashes")


def quiet_read(path: Path) -> list[Record]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BrokenLog)
        return list(read(path))


def stock_read(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        return [message.data for _, _, message in make_reader(file, validate_crcs=True).iter_messages()]


def test_a_killed_writer_loses_at_most_its_last_second(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    writer = subprocess.Popen([sys.executable, "-m", "tests.log.crash_writer", path, "100"], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    handed: list[tuple[int, int]] = []
    for line in writer.stdout:
        time, number = line.split()
        handed.append((int(time), int(number)))
        if len(handed) == 350:
            os.kill(writer.pid, signal.SIGKILL)
            break
    handed += [(int(a), int(b)) for a, b in (line.split() for line in writer.stdout.read().splitlines() if line.count(" ") == 1)]
    writer.wait()
    with pytest.warns(BrokenLog, match="breaks off"):
        found = list(read(path))
    assert [record.sequence for record in found] == list(range(len(found)))
    killed = handed[-1][0]
    due = [number for time, number in handed if time < killed - 1_100_000_000]
    assert len(due) > 100
    assert len(found) >= len(due)
    assert all(record.decode() for record in found)
    report = recover(path, tmp_path / "whole.mcap")
    assert (report.messages, report.finished) == (len(found), False)
    assert stock_read(tmp_path / "whole.mcap") == [record.payload for record in found]


@cache
def whole_log(folder: Path, compression: str) -> tuple[bytes, list[Record]]:
    path = folder / f"whole-{compression}.mcap"
    records = records_of(game(1, 20))
    write_log(path, records, compression=compression, chunk_size=1500)
    return path.read_bytes(), records


@pytest.mark.parametrize("compression", ["zstd", "none"])
@QUIET
@given(place=st.floats(0, 1))
@example(place=0.0)
@example(place=1e-9)
@example(place=1.0)
def test_a_file_cut_anywhere_yields_a_prefix(folder: Path, compression: str, place: float) -> None:
    data, records = whole_log(folder, compression)
    cut = round(place * len(data))
    path, target = folder / "cut.mcap", folder / "recovered.mcap"
    path.write_bytes(data[:cut])
    target.unlink(missing_ok=True)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = list(read(path))
    assert found == records[: len(found)]
    assert bool(caught) == (cut < len(data))
    (report,) = info(path)
    assert (report.count, report.finished) == (len(found), cut == len(data))
    if cut < 8:
        with pytest.raises(NothingToRecover, match=f"only {cut} bytes"):
            recover(path, target)
        return
    assert recover(path, target).messages == len(found)
    assert stock_read(target) == [record.payload for record in found]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert list(read(target)) == found


def test_all_but_the_last_chunk_of_a_cut_file_is_there(folder: Path) -> None:
    data, records = whole_log(folder, "none")
    path = folder / "cut-late.mcap"
    for cut in range(len(data) // 2, len(data), 997):
        path.write_bytes(data[:cut])
        held = sum(1 for record in records if data.find(record.payload, 0, cut) >= 0)
        assert len(quiet_read(path)) >= held - 20


def test_a_recovered_log_keeps_what_it_says_of_itself(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap", RunMetadata(commit="test", arena="table", started=START), sync=False) as log:
        put(log, 3, 0)
        log.gap("tick", "referee", 2, log_time=START + 9)
    recover(tmp_path / "log.mcap", tmp_path / "whole.mcap")
    with open_log(tmp_path / "log.mcap") as before, open_log(tmp_path / "whole.mcap") as after:
        assert after.metadata == before.metadata
        assert (after.metadata["commit"], after.metadata["arena"]) == ("test", "table")
        assert after.gaps == {"tick referee": 2}


@QUIET
@given(damages=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=4), data=st.data())
def test_damage_never_raises_and_never_yields_other_messages(
    folder: Path, damages: list[tuple[float, int]], data: st.DataObject
) -> None:
    whole, records = whole_log(folder, data.draw(st.sampled_from(["zstd", "lz4", "none"])))
    damaged = bytearray(whole)
    for place, value in damages:
        damaged[min(round(place * len(whole)), len(whole) - 1)] = value
    path, target = folder / "damaged.mcap", folder / "mended.mcap"
    path.write_bytes(bytes(damaged))
    target.unlink(missing_ok=True)
    payloads = {record.payload for record in records}
    assert {record.payload for record in quiet_read(path)} <= payloads
    if damaged[:8] == MCAP0_MAGIC:
        recover(path, target)
        assert set(stock_read(target)) <= payloads
    info(path)


@pytest.mark.parametrize("content", [b"", b"\x89", b"hello, this is no log at all", bytes(1000)])
def test_what_is_no_log_is_said(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "no.mcap"
    path.write_bytes(content)
    with pytest.warns(BrokenLog, match="not an MCAP file|bytes"):
        assert list(read(path)) == []


def test_a_damaged_chunk_costs_only_itself(tmp_path: Path) -> None:
    records = records_of(game(1, 40))
    path = tmp_path / "log.mcap"
    write_log(path, records, chunk_size=3000, compression="none")
    data = bytearray(path.read_bytes())
    data[data.find(records[len(records) // 2].payload) + 3] ^= 0xFF
    path.write_bytes(bytes(data))
    with pytest.warns(BrokenLog, match="damaged chunk at byte .*CRC does not match"):
        found = list(read(path))
    lost = [record for record in records if record not in found]
    assert 1 <= len(lost) < 100
    assert found == [record for record in records if record in found]


POSE = encode(Pose(stamp=1, x=0.1, y=0.2, heading=0.3))


def put(log: LogWriter, count: int, start: int) -> None:
    for number in range(start, start + count):
        record = Record("hider/pose", "simulator", number, START + number, START + number, POSE)
        write_record(log, record)


@pytest.fixture
def file_size_limit() -> object:
    """The kernel refuses writes beyond a size, like a full disk does; Python ignores SIGXFSZ."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def limit(size: int | None) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft if size is None else size, hard))

    yield limit
    limit(None)


def full_disk_on(monkeypatch: pytest.MonkeyPatch, room: list[int]) -> None:
    """Writes beyond `room` bytes end as on a full disk: what fits is written, the rest refused."""
    import errno

    import vantage.log.part as part

    real = os.pwritev

    def pwritev(file: int, buffers: list[bytes], offset: int) -> int:
        data = b"".join(buffers)
        left = room[0] - offset
        if left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(file, [data[:left]], offset)

    monkeypatch.setattr(part.os, "pwritev", pwritev)
    monkeypatch.setattr(part.os, "pwrite", lambda file, data, offset: pwritev(file, [bytes(data)], offset))


def test_a_full_disk_drops_counts_and_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.mcap"
    log = LogWriter(path, RunMetadata(), compression="none", chunk_size=2000, keep_going=True)
    put(log, 100, 0)
    log.flush()
    assert log.error is None
    room = [log.part.stat().st_size + 1000]
    full_disk_on(monkeypatch, room)
    put(log, 100, 100)
    log.flush()
    assert log.error is not None
    assert "the disk is full" in log.error
    assert str(path) in log.error
    dropped = log.dropped["hider/pose", "simulator"]
    assert 0 < dropped <= 100
    # While the disk is full, everything up to then reads, by whole records.
    kept = quiet_read(path)
    assert [record.sequence for record in kept] == list(range(200 - dropped))
    room[0] = 10**9
    put(log, 100, 200)
    log.close()
    assert log.error is None
    found = list(read(path))
    poses = [record for record in found if record.key == "hider/pose"]
    missed = sum(record.decode().missed for record in found if record.key == "gap")  # type: ignore[attr-defined]
    assert len(poses) + missed == 300
    assert missed == dropped == log.dropped["hider/pose", "simulator"]
    assert [record.sequence for record in poses][-100:] == list(range(200, 300))
    assert len(stock_read(path)) == len(found)


def test_a_disk_that_stays_full_leaves_a_readable_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.mcap"
    log = LogWriter(path, RunMetadata(), chunk_size=1000, split_bytes=10_000, keep_going=True)
    put(log, 200, 0)
    log.flush()
    kept = len(quiet_read(log.part))
    full_disk_on(monkeypatch, [0])
    put(log, 500, 200)
    log.close()
    assert log.error is not None
    assert sum(log.dropped.values()) >= 500
    assert len(quiet_read(tmp_path)) >= kept
    target = tmp_path / "whole.mcap"
    monkeypatch.undo()
    first = min(tmp_path.glob("log_*.mcap"))
    assert recover(first, target).messages >= kept


def test_a_file_that_may_not_grow_is_followed_by_another_part(tmp_path: Path, file_size_limit: object) -> None:
    log = LogWriter(tmp_path / "log.mcap", RunMetadata(), compression="none", chunk_size=2000, keep_going=True)
    file_size_limit(30_000)  # type: ignore[operator]
    put(log, 1000, 0)
    file_size_limit(None)  # type: ignore[operator]
    log.close()
    assert log.parts_begun > 1
    found = quiet_read(tmp_path)
    poses = [record for record in found if record.key == "hider/pose"]
    assert len(poses) + log.dropped["hider/pose", "simulator"] == 1000
    assert len(poses) > 900


def test_a_folder_that_cannot_be_written_is_said_at_the_start(tmp_path: Path) -> None:
    with pytest.raises(OSError):
        LogWriter(tmp_path / "missing" / "log.mcap", RunMetadata())
