"""Logs of many parts, parts that are missing, logs that are being recorded, and who may read them."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest

from tests.log.making import game, records_of, write_log, write_record
from vantage.log import LogWriter, Record, RunMetadata, find_logs, open_log, read
from vantage.log.reader import parts_of
from vantage.log.recover import recover
from vantage.log.report import info

VANTAGE = Path(sys.executable).parent / "vantage"


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"COLUMNS": "300"}
    return subprocess.run([VANTAGE, "log", *words], capture_output=True, text=True, check=False, env=environment)


def write_parts(path: Path, records: list[Record]) -> list[Path]:
    """Write a log of which every message has a part of its own."""
    with LogWriter(path, RunMetadata(started=5), sync=False, split_bytes=1) as log:
        for record in records:
            write_record(log, record)
    return sorted(path.parent.iterdir(), key=lambda part: int(part.stem.rpartition("_")[2]))


def test_more_than_a_thousand_parts_are_read_in_order_with_few_open_files(tmp_path: Path) -> None:
    records = [Record("stranger/key", "", number, 100 + number, 5, b"\x00") for number in range(1030)]
    parts = write_parts(tmp_path / "run.mcap", records)
    assert len(parts) == 1030
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
    try:
        assert find_logs(tmp_path) == [parts]
        assert parts_of(parts[0]) == parts
        with open_log(*parts) as log:
            assert [record.sequence for record in log.records()] == list(range(1030))
            assert log.breaks == []
        (report,) = info(tmp_path)
        assert (report.count, report.breaks, report.finished) == (1030, [], True)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.parametrize(
    ("removed", "said"),
    [
        ([0], ["run_000.mcap is missing"]),
        ([1, 2, 4], ["run_001.mcap to run_002.mcap are missing", "run_004.mcap is missing"]),
        ([6], ["run_006.mcap is missing"]),
    ],
)
def test_missing_parts_are_named(tmp_path: Path, removed: list[int], said: list[str]) -> None:
    parts = write_parts(tmp_path / "run.mcap", [Record("stranger/key", "", n, 100 + n, 5, b"\x00") for n in range(7)])
    for number in removed:
        parts[number].unlink()
    with open_log(*find_logs(tmp_path)[0]) as log:
        assert log.breaks == said
    done = run("info", tmp_path)
    assert done.returncode == 2
    for text in said:
        assert text in done.stdout
    left = [number for number in range(7) if number not in removed]
    with pytest.warns(match="missing"):
        assert [record.sequence for record in read(tmp_path)] == left


def test_a_part_named_alone_does_not_miss_those_beside_it(tmp_path: Path) -> None:
    parts = write_parts(tmp_path / "run.mcap", [Record("stranger/key", "", n, 100 + n, 5, b"\x00") for n in range(5)])
    for part in parts:
        with open_log(part) as log:
            assert log.breaks == []
    recover(parts[2], tmp_path / "run_002-recovered.mcap")
    with open_log(tmp_path / "run_002-recovered.mcap") as log:
        assert log.breaks == []


def test_parts_of_runs_of_one_name_are_kept_apart(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    first = write_parts(tmp_path / "a" / "run.mcap", [Record("stranger/key", "", n, 100 + n, 5, b"\x00") for n in range(3)])
    other = LogWriter(tmp_path / "run.mcap", RunMetadata(started=6), sync=False, split_bytes=1)
    for number in range(3):
        other.write("stranger/key", b"\x01", log_time=number, publish_time=1, sequence=number, publisher="")
    other.close()
    for number in (0, 1):
        (tmp_path / f"run_00{number}.mcap").unlink()
    for number in (0, 1):
        first[number].rename(tmp_path / first[number].name)
    first[2].unlink()
    assert [[path.name for path in parts] for parts in find_logs(tmp_path)] == [
        ["run_000.mcap", "run_001.mcap"],
        ["run_002.mcap"],
    ]
    assert [path.name for path in parts_of(tmp_path / "run_000.mcap")] == ["run_000.mcap", "run_001.mcap"]


def test_a_log_that_is_being_recorded_is_no_broken_one(tmp_path: Path) -> None:
    records = records_of(game(1, 20))
    path = tmp_path / "live.mcap"
    log = LogWriter(path, RunMetadata())
    for record in records:
        write_record(log, record)
    log.flush()
    with open_log(path) as live:
        assert (live.recording, live.finished, live.breaks) == (True, False, [])
        assert list(live.records()) == records
    done = run("info", path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "(being recorded now)" in done.stdout
    assert "recover" not in done.stdout and "breaks off" not in done.stdout
    done = run("export", path)
    assert done.returncode == 0
    assert "is being recorded now" in done.stdout
    assert "being recorded now" in str(recover(path, tmp_path / "copy.mcap"))
    log.close()
    with open_log(path) as closed:
        assert (closed.recording, closed.finished, closed.breaks) == (False, True, [])
    assert "being recorded" not in run("info", path).stdout


def test_the_log_of_a_killed_writer_is_a_broken_one(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    writer = subprocess.Popen([sys.executable, "-m", "tests.log.crash_writer", path, "500"], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    for _ in range(3):
        writer.stdout.readline()
    with open_log(path) as live:
        assert (live.recording, live.breaks) == (True, [])
    writer.send_signal(signal.SIGKILL)
    writer.communicate()
    with open_log(path) as dead:
        assert not dead.recording
        assert "breaks off" in dead.breaks[0]
    assert run("info", path).returncode == 2


def test_logs_are_for_their_owner_and_group(tmp_path: Path) -> None:
    umask = os.umask(0o022)
    try:
        folder = tmp_path / "new" / "logs"
        LogWriter(folder / "log.mcap", {}, keep_going=True).close()
        assert [oct(path.stat().st_mode & 0o777) for path in (folder, folder / "log.mcap")] == ["0o750", "0o640"]
        recover(folder / "log.mcap", folder / "copy.mcap")
        assert oct((folder / "copy.mcap").stat().st_mode & 0o777) == "0o640"
    finally:
        os.umask(umask)


def test_a_part_of_many_chunks_stays_small_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Recording for days on a quiet table writes a chunk a second into one part."""
    records = [record for record in records_of(game(1, 1)) if record.key != "gap"][:12]

    def write_chunks(log: LogWriter, count: int) -> None:
        for _ in range(count):
            for record in records:
                write_record(log, record)
            log.flush()

    log = LogWriter(tmp_path / "log.mcap", {}, sync=False, split_bytes=10**9)
    write_chunks(log, 100)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    write_chunks(log, 2000)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    log.close()
    assert grown < 2000 * 400
    monkeypatch.setattr("vantage.log.writer.MOST_CHUNKS", 50)
    with LogWriter(tmp_path / "days.mcap", {}, sync=False, split_bytes=10**9) as days:
        write_chunks(days, 120)
    assert days.parts_begun == 3


def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    write_log(tmp_path / "log.mcap", records_of(game(1, 3)))
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([VANTAGE, "log", "info", tmp_path / "log.mcap"], stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")
