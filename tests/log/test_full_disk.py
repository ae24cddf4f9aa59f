"""Full and read-only disks, deleted folders: the writer goes on, counts every loss, and notes it when there is room again."""

from __future__ import annotations

import errno
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas import Gap, Pose, encode
from tests.log.disks import Disk, RefusingDisk, small_disk
from tests.log.making import START, game, records_of, write_log, write_record
from vantage.log import BrokenLog, LogWriter, Record, RunMetadata, find_logs, open_log, read
from vantage.log.export import export_log
from vantage.log.recover import recover

VANTAGE = Path(sys.executable).parent / "vantage"
POSE = encode(Pose(stamp=1, x=0.1, y=0.2, heading=0.3))


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    with small_disk(tmp_path / "disk", monkeypatch) as made:
        yield made


@pytest.fixture(params=["mounted", "refusing"])
def any_disk(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    """Both kinds, so that the second is known to behave like a real one."""
    if request.param == "mounted":
        yield request.getfixturevalue("disk")
    else:
        (tmp_path / "refusing").mkdir()
        yield RefusingDisk(tmp_path / "refusing", monkeypatch)


def put(log: LogWriter, count: int, start: int) -> None:
    for number in range(start, start + count):
        write_record(log, Record("hider/pose", "simulator", number, START + number, START + number, POSE))


def writer(folder: Path, **options: object) -> LogWriter:
    settings = {"split_bytes": 10**9, "compression": "none", "keep_going": True} | options
    return LogWriter(folder / "log.mcap", RunMetadata(started=START), **settings)  # type: ignore[arg-type]


def found_in(folder: Path) -> tuple[list[int], int]:
    """Return the sequence numbers of the poses in the logs there, and how many messages their notes miss."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BrokenLog)
        records = list(read(folder))
    missed = sum(message.missed for record in records if record.key == "gap" and isinstance(message := record.decode(), Gap))
    return [record.sequence for record in records if record.key == "hider/pose"], missed


def test_every_loss_is_counted_and_noted_when_there_is_room(any_disk: Disk) -> None:
    log = writer(any_disk.folder)
    put(log, 2000, 0)
    log.flush()
    assert log.error is None
    any_disk.fill()
    for round in range(1, 13):
        put(log, 2000, 2000 * round)
        log.flush()
        assert log.error is not None and "the disk is full" in log.error
    assert log.dropped == {("hider/pose", "simulator"): 24_000}
    log.flush()  # with nothing to write
    assert log.error is not None
    log.gap("tick", "referee", 7)
    log.flush()
    any_disk.free()
    put(log, 2000, 26_000)
    log.flush()
    log.flush()
    assert log.error is None
    log.close()
    poses, missed = found_in(any_disk.folder)
    assert poses == [*range(2000), *range(26_000, 28_000)]
    assert missed == 24_007
    with open_log(*find_logs(any_disk.folder)[0]) as closed:
        assert closed.gaps == {"hider/pose simulator": 24_000, "tick referee": 7}


def test_notes_survive_chunks_that_are_dropped(any_disk: Disk) -> None:
    """A disk that fills up again and again, with little room: the notes of the first losses go into chunks that are lost, too."""
    log = writer(any_disk.folder, chunk_size=3000)
    sent = 0
    for turn in range(6):
        any_disk.fill(leave=10_000 * (turn % 3))
        put(log, 300, sent)
        sent += 300
        log.flush()
        any_disk.free()
        if turn % 2:
            put(log, 50, sent)
            sent += 50
            log.flush()
    log.close()
    poses, missed = found_in(any_disk.folder)
    assert missed > 0
    assert len(poses) + missed == sent
    assert missed == log.dropped["hider/pose", "simulator"]


def test_no_room_at_the_start_is_waited_for(any_disk: Disk) -> None:
    any_disk.fill()
    log = writer(any_disk.folder)
    assert log.error == f"the disk is full: no room in {any_disk.folder}; messages dropped so far: 0"
    put(log, 500, 0)
    log.flush()
    assert log.error == f"the disk is full: no room in {any_disk.folder}; messages dropped so far: 500"
    any_disk.free()
    log.flush()
    put(log, 100, 500)
    log.flush()
    assert log.error is None
    log.close()
    assert found_in(any_disk.folder) == (list(range(500, 600)), 500)


def test_what_is_still_lost_at_the_end_is_in_the_summary_or_the_log_is_as_it_was(any_disk: Disk) -> None:
    log = writer(any_disk.folder)
    put(log, 100, 0)
    log.flush()
    any_disk.fill()
    put(log, 100, 100)
    log.close()
    assert log.error is not None
    any_disk.free()
    assert found_in(any_disk.folder) == (list(range(100)), 0)


def test_a_read_only_disk_is_named_and_waited_for(disk: Disk) -> None:
    disk.forbid_writing()
    log = writer(disk.folder)
    assert log.error is not None and "Read-only file system" in log.error and str(disk.folder) in log.error
    put(log, 10, 0)
    log.close()
    assert log.dropped == {("hider/pose", "simulator"): 10}


@pytest.mark.parametrize("gone", ["file", "folder"])
def test_a_deleted_log_is_noticed_and_another_part_begins(tmp_path: Path, gone: str) -> None:
    folder = tmp_path / "logs"
    log = writer(folder)
    put(log, 1000, 0)
    log.gap("tick", "referee", 3)
    log.flush()
    first = log.part
    if gone == "file":
        first.unlink()
    else:
        shutil.rmtree(folder)
    put(log, 200, 1000)
    log.flush()
    assert log.displaced.startswith(f"{first} was deleted with 1200 messages")
    assert log.part != first and log.part.is_file()
    put(log, 100, 1200)
    log.close()
    assert log.error is None
    assert found_in(folder) == (list(range(1200, 1300)), 1203)
    with open_log(*find_logs(folder)[0]) as left:
        assert left.breaks == ["log_000.mcap is missing"]


def test_a_log_that_was_moved_away_is_finished_there(tmp_path: Path) -> None:
    (tmp_path / "away").mkdir()
    log = writer(tmp_path / "logs")
    put(log, 1000, 0)
    log.flush()
    log.part.rename(tmp_path / "away" / log.part.name)
    put(log, 10, 1000)
    log.flush()
    assert "was moved while it was being written" in log.displaced
    put(log, 10, 1010)
    log.close()
    assert found_in(tmp_path / "away") == (list(range(1010)), 0)
    assert found_in(tmp_path / "logs") == (list(range(1010, 1020)), 0)


def test_a_folder_that_cannot_be_made_again_is_said(tmp_path: Path) -> None:
    log = writer(tmp_path / "logs")
    put(log, 10, 0)
    log.flush()
    shutil.rmtree(tmp_path / "logs")
    (tmp_path / "logs").write_text("in the way")
    log.flush()
    assert log.error is not None and str(tmp_path / "logs") in log.error
    put(log, 10, 10)
    log.flush()
    (tmp_path / "logs").unlink()
    put(log, 10, 20)
    log.flush()
    log.flush()
    assert log.error is None
    log.close()
    assert found_in(tmp_path / "logs") == (list(range(20, 30)), 20)


def test_a_link_that_leads_nowhere_gets_its_folder(tmp_path: Path) -> None:
    """As `recordings` in the folder of a deployment, when the logs were deleted."""
    (tmp_path / "recordings").symlink_to(tmp_path / "logs" / "deleted")
    log = writer(tmp_path / "recordings")
    put(log, 10, 0)
    log.close()
    assert found_in(tmp_path / "logs" / "deleted") == (list(range(10)), 0)


def test_without_keep_going_nothing_is_lost_unseen(any_disk: Disk) -> None:
    log = LogWriter(any_disk.folder / "log.mcap", RunMetadata(), chunk_size=1000)
    any_disk.fill()
    with pytest.raises(OSError, match="No space left on device") as raised, log:
        put(log, 1000, 0)
    assert raised.value.filename == str(log.part)


def test_a_log_that_is_deleted_under_a_strict_writer_is_an_error(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log.mcap", {})
    log.part.unlink()
    with pytest.raises(FileNotFoundError, match="deleted while it was being written"):
        log.close()
    assert list(tmp_path.iterdir()) == []


def test_recover_on_a_full_disk_leaves_nothing_and_goes_on_when_there_is_room(any_disk: Disk, tmp_path: Path) -> None:
    write_log(tmp_path / "log.mcap", records_of(game(1, 300)), compression="none")
    target = any_disk.folder / "new" / "whole.mcap"
    any_disk.fill(leave=20_000)
    with pytest.raises(OSError, match="No space left on device") as raised:
        recover(tmp_path / "log.mcap", target)
    assert raised.value.filename == str(target)
    assert not list(any_disk.folder.rglob("*.mcap"))
    any_disk.free()
    assert recover(tmp_path / "log.mcap", target).messages == len(records_of(game(1, 300)))


def test_an_export_on_a_full_disk_leaves_nothing(any_disk: Disk, tmp_path: Path) -> None:
    from services.recorder.appearance import arena_appearance
    from vantage.log.viewer import Viewer

    write_log(tmp_path / "log.mcap", records_of(game(1, 300)))
    any_disk.fill(leave=20_000)
    with open_log(tmp_path / "log.mcap") as log, pytest.raises(OSError, match="No space left on device") as raised:
        export_log(log, any_disk.folder / "copy.mcap", Viewer(arena_appearance()))
    assert raised.value.filename == str(any_disk.folder / "copy.mcap")
    assert not [path for path in any_disk.folder.iterdir() if path.name != "ballast"]


@pytest.mark.parametrize("words", [("recover", "--to"), ("export", "--to")], ids=["recover", "export"])
def test_a_place_that_cannot_be_written_is_one_line(disk: Disk, tmp_path: Path, words: tuple[str, str]) -> None:
    write_log(tmp_path / "log.mcap", records_of(game(1, 3)))
    if isinstance(disk, RefusingDisk):  # its refusals are of this process only
        target, why = Path("/proc/whole.mcap"), errno.ENOENT
    else:
        disk.forbid_writing()
        target, why = disk.folder / "whole.mcap", errno.EROFS
    command, option = words
    done = subprocess.run([VANTAGE, "log", command, tmp_path / "log.mcap", option, target], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith(f"vantage log {command}: {target}: ")
    assert (done.stderr.count("\n"), "Traceback" in done.stderr) == (1, False), why
