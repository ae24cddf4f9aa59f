"""The recorder: every byte of the bus in the log, in process and as a process."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

from schemas import Gap, Health, Pose, encode
from services.recorder.core import RecorderCore, RecorderSettings, log_path, weights_hash
from tests.log.disks import small_disk
from tests.log.making import game
from vantage.bus import InProcessNetwork, Lost, Sample, VirtualClock
from vantage.bus.zenoh_bus import ZenohBus
from vantage.log import BrokenLog, Record, find_logs, open_log, read
from vantage.log.report import info
from vantage.service import SECOND, Publish, Runtime, Send, Woken

NOW = 1_800_000_000 * SECOND
PATIENCE = 120.0
"""Seconds that bound a failure only: a busy machine is slow, not wrong."""


def core(folder: Path, **options: object) -> RecorderCore:
    settings = RecorderSettings(logs=folder / "logs", weights=folder / "weights", **options)  # type: ignore[arg-type]
    return RecorderCore(settings, "table", "the process table", NOW)


def publisher_of(key: str) -> str:
    if key in ("episode", "tick"):
        return "referee"
    if key.endswith("command") or key == "hider/plan":
        return "seeker" if key.startswith("seeker") else "planner"
    return "simulator"


@pytest.mark.parametrize("viewer", [False, True])
def test_a_game_is_recorded_byte_for_byte(tmp_path: Path, viewer: bool) -> None:
    clock = VirtualClock(NOW)
    network = InProcessNetwork(clock=clock)
    recorder = core(tmp_path, viewer=viewer)
    runtime = Runtime(recorder, network.session("recorder"), clock)
    sessions = {name: network.session(name) for name in ("referee", "simulator", "seeker", "planner")}
    said = []
    for key, message in game(1, 20):
        clock.advance(0.01)
        sessions[publisher_of(key)].publish(key, message)
        said.append((key, publisher_of(key), clock.now, encode(message)))
        runtime.drain()
    recorder.close()
    found = [record for record in read(tmp_path / "logs") if not record.key.startswith("health/")]
    assert [(r.key, r.publisher, r.publish_time, r.payload) for r in found] == said
    report = info(tmp_path / "logs")[0]
    assert {topic.missing for topic in report.topics.values()} == {0}
    with open_log(*find_logs(tmp_path / "logs")[0]) as log:
        assert log.metadata["arena"] == "table"
        assert "the process table" in log.metadata["configuration"]
    both = list(read(tmp_path / "logs", viewer=True))
    assert (len(both) > len(found) + 40) == viewer


def test_losses_are_noted_in_the_log_and_on_the_bus(tmp_path: Path) -> None:
    recorder = core(tmp_path)
    (sent,) = recorder.step(Lost("hider/pose", "simulator", 4), NOW)
    assert isinstance(sent, Publish)
    assert (sent.key, sent.message.key, sent.message.missed) == ("gap", "hider/pose", 4)  # type: ignore[attr-defined]
    # Its own note comes back over the bus, and is in the log once.
    recorder.step(Sample("gap", encode(sent.message), "recorder", 0, NOW, type(sent.message)), NOW + 1)
    recorder.close()
    (record,) = read(tmp_path / "logs")
    assert record.decode() == sent.message
    with open_log(*find_logs(tmp_path / "logs")[0]) as log:
        assert log.gaps == {"hider/pose simulator": 4}


def test_malformed_and_unknown_messages_are_kept_and_counted(tmp_path: Path) -> None:
    clock = VirtualClock(NOW)
    network = InProcessNetwork(clock=clock)
    recorder = core(tmp_path)
    runtime = Runtime(recorder, network.session("recorder"), clock)
    for number in range(1000):
        runtime._handle(Sample(f"stranger/{number}", b"\x01", "", 0, 0), NOW)
    runtime._handle(Sample("hider/pose", b"nonsense", "simulator", 0, NOW, Pose), NOW)
    runtime._handle(Sample("hider/pose", encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0)), "simulator", 1, NOW, Pose), NOW)
    health = runtime.health_report("ok")
    counts = {item.key: (item.received, item.malformed) for item in health.inputs}
    assert counts["hider/pose"] == (2, 1)
    assert sum(malformed for _, malformed in counts.values()) == 1001
    assert health.failed == 0
    assert "malformed" in health.reason
    recorder.close()
    found = [record for record in read(tmp_path / "logs") if record.key == "hider/pose"]
    assert [record.well_formed for record in found] == [False, True]
    assert found[0].payload == b"nonsense"
    assert recorder.writer.undeclared == 1000


def test_it_flushes_each_second_without_being_spoken_to(tmp_path: Path) -> None:
    recorder = core(tmp_path)
    recorder.step(Sample("hider/pose", encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0)), "simulator", 0, NOW, Pose), NOW)
    assert recorder.wake_at() == NOW + SECOND
    recorder.step(Woken(), NOW + SECOND)
    assert recorder.wake_at() == NOW + 2 * SECOND
    assert len(list(read(tmp_path / "logs"))) == 1
    recorder.close()


def test_a_full_disk_is_trouble_in_health(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = VirtualClock(NOW)
    recorder = core(tmp_path)
    runtime = Runtime(recorder, InProcessNetwork(clock=clock).session("recorder"), clock)

    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("vantage.log.part.os.pwritev", refuse)
    pose = Sample("hider/pose", encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0)), "simulator", 0, NOW, Pose)
    recorder.step(pose, NOW)
    recorder.step(Woken(), NOW + SECOND)
    health = runtime.health_report("ok")
    assert health.state == "degraded"
    assert "the disk is full; messages dropped so far: 1" in health.reason
    monkeypatch.undo()
    recorder.step(pose, NOW + 2 * SECOND)
    recorder.step(Woken(), NOW + 2 * SECOND)
    assert runtime.health_report("ok").state == "ok"
    recorder.close()


POSE = encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0))


def hear(recorder: RecorderCore, count: int, number: int, at: int) -> list[Gap]:
    """Let it hear poses, then wake it at a time; return the losses that it announces."""
    sends: list[Send] = []
    for place in range(number, number + count):
        sends += recorder.step(Sample("hider/pose", POSE, "simulator", place, at, Pose), at - 1)
    sends += recorder.step(Woken(), at)
    return [send.message for send in sends if isinstance(send, Publish) and isinstance(send.message, Gap)]


def test_a_full_disk_from_the_start_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """It starts, is degraded with the reason, announces each loss, and records as soon as there is room."""
    clock = VirtualClock(NOW)
    with small_disk(tmp_path / "disk", monkeypatch) as disk:
        disk.fill()
        recorder = core(disk.folder)
        runtime = Runtime(recorder, InProcessNetwork(clock=clock).session("recorder"), clock)
        full = f"the disk is full: no room in {disk.folder / 'logs'}; messages dropped so far: "
        assert (runtime.health_report("ok").state, runtime.health_report("ok").reason) == ("degraded", full + "0")
        for second in range(1, 5):
            (gap,) = hear(recorder, 100, 100 * second, NOW + second * SECOND)
            assert (gap.key, gap.publisher, gap.missed) == ("hider/pose", "simulator", 100)
            assert runtime.health_report("ok").reason == f"{full}{100 * second}"
        disk.free()
        assert hear(recorder, 100, 500, NOW + 5 * SECOND) == []
        assert hear(recorder, 100, 600, NOW + 6 * SECOND) == []
        assert runtime.health_report("ok").state == "ok"
        recorder.close()
        records = list(read(disk.folder / "logs"))
    assert [record.sequence for record in records if record.key == "hider/pose"] == list(range(500, 700))
    missed = [record.decode().missed for record in records if record.key == "gap"]  # type: ignore[attr-defined]
    assert missed == [400]
    lines = [record.getMessage() for record in caplog.records]
    assert lines == [f"recorder: {full}0", "recorder: the log is being written again"]


def test_a_deleted_folder_is_trouble_in_health_and_recording_goes_on(tmp_path: Path) -> None:
    clock = VirtualClock(NOW)
    recorder = core(tmp_path)
    runtime = Runtime(recorder, InProcessNetwork(clock=clock).session("recorder"), clock)
    assert hear(recorder, 100, 0, NOW + SECOND) == []
    shutil.rmtree(tmp_path / "logs")
    (gap,) = hear(recorder, 10, 100, NOW + 2 * SECOND)
    assert gap.missed == 110
    health = runtime.health_report("ok")
    assert health.state == "degraded"
    assert "was deleted with 110 messages while it was being written; the log goes on in table-" in health.reason
    assert hear(recorder, 10, 110, NOW + 3 * SECOND) == []
    assert runtime.health_report("ok").state == "degraded"
    assert hear(recorder, 10, 120, NOW + 13 * SECOND) == []
    assert runtime.health_report("ok").state == "ok"
    recorder.close()
    records = list(read_quietly(tmp_path / "logs"))
    assert [record.sequence for record in records if record.key == "hider/pose"] == list(range(110, 130))
    assert sum(record.decode().missed for record in records if record.key == "gap") == 110  # type: ignore[attr-defined]


@pytest.mark.parametrize(("readable_by", "modes"), [("owner", "700 600"), ("group", "750 640"), ("everyone", "755 644")])
def test_who_may_read_the_logs_is_a_setting(tmp_path: Path, readable_by: str, modes: str) -> None:
    umask = os.umask(0o022)
    try:
        recorder = core(tmp_path, readable_by=readable_by)
    finally:
        os.umask(umask)
    paths = (tmp_path / "logs", recorder.writer.part)
    assert " ".join(f"{path.stat().st_mode & 0o777:o}" for path in paths) == modes
    recorder.close()


def test_parts_by_size_and_by_time(tmp_path: Path) -> None:
    recorder = core(tmp_path, split_megabytes=None, split_minutes=1.0)
    pose = encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0))
    for number in range(10):
        at = NOW + number * 20 * SECOND
        recorder.step(Sample("hider/pose", pose, "simulator", number, at, Pose), at)
    recorder.close()
    assert len(list((tmp_path / "logs").iterdir())) == 4
    assert [record.sequence for record in read(tmp_path / "logs")] == list(range(10))


def test_names_are_free_and_empty_logs_leave_nothing(tmp_path: Path) -> None:
    first = core(tmp_path)
    second = core(tmp_path)
    assert first.writer.part != second.writer.part
    first.close()
    second.close()
    assert list((tmp_path / "logs").iterdir()) == []
    assert log_path(tmp_path, "table", NOW).name.startswith("table-20")


def test_weights_are_named_by_their_hash(tmp_path: Path) -> None:
    (tmp_path / "vpn.safetensors").write_bytes(b"abc")
    assert weights_hash(tmp_path) == "vpn:ba7816bf8f01cfea"
    assert weights_hash(tmp_path / "missing") == ""


@pytest.fixture
def folder() -> Iterator[Path]:
    # Sockets want a short path.
    with tempfile.TemporaryDirectory(prefix="vr") as name:
        yield Path(name)


def start(folder: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "services.recorder", "--folder", str(folder), "--logs", str(folder / "logs"), *options]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def await_recorder(bus: ZenohBus, uptime: float = 0.0, state: str = "ok") -> Health:
    """Wait until the recorder is well, or in another state."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        event = bus.receive(0.2)
        if isinstance(event, Sample) and event.key == "health/recorder":
            health = event.decode()
            assert isinstance(health, Health)
            if health.state == state and health.uptime >= uptime and bus.has_reader("hider/pose"):
                return health
    raise AssertionError("the recorder does not come up")


def read_quietly(path: Path) -> list[Record]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BrokenLog)
        return list(read(path))


def sequences_of_poses(folder: Path) -> set[int]:
    """Sequence numbers of the poses that can be read back, also while the log is being written."""
    return {record.sequence for record in read_quietly(folder / "logs") if record.key == "hider/pose"}


def pose(number: int) -> Pose:
    return Pose(stamp=time.time_ns(), step=number, x=0.1, y=0.2, heading=0.3)


@pytest.mark.stack
def test_the_process_records_strangers_and_ends_on_sigterm(folder: Path) -> None:
    recorder = start(folder)
    with ZenohBus("simulator", folder) as bus:
        bus.subscribe("health/recorder")
        await_recorder(bus)
        for number in range(300):
            bus.publish("hider/pose", pose(number))
        bus._session.put("vantage/table/stranger/key", b"who am I")  # type: ignore[union-attr]
        bus._session.put("vantage/table/seeker/pose", b"nonsense")  # type: ignore[union-attr]
        before = time.time_ns()
        health = await_recorder(bus)
        while health.stamp < before + SECOND:
            health = await_recorder(bus)
        assert {item.key: item.received for item in health.inputs}["hider/pose"] == 300
        recorder.send_signal(signal.SIGTERM)
        assert recorder.wait(PATIENCE) == 0
    records = list(read(folder / "logs"))
    assert [record.sequence for record in records if record.key == "hider/pose"] == list(range(300))
    assert [(r.payload, r.well_formed) for r in records if r.key == "stranger/key"] == [(b"who am I", False)]
    assert [(r.payload, r.well_formed) for r in records if r.key == "seeker/pose"] == [(b"nonsense", False)]
    (path,) = (folder / "logs").iterdir()
    with path.open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) > len(records)


@pytest.mark.stack
def test_a_killed_recorder_keeps_what_it_had_flushed_and_its_successor_goes_on(folder: Path) -> None:
    first = start(folder)
    with ZenohBus("simulator", folder) as bus:
        bus.subscribe("health/recorder")
        await_recorder(bus)
        for number in range(200):
            bus.publish("hider/pose", pose(number))
        # It flushes each second (see above): what is in the file before it is killed has to be there afterwards.
        deadline = time.monotonic() + PATIENCE
        while len(sequences_of_poses(folder)) < 200:
            assert time.monotonic() < deadline, "it does not flush"
            bus.publish("hider/pose", pose(number := number + 1))
            bus.receive(0.05)
        kept = sequences_of_poses(folder)
        os.kill(first.pid, signal.SIGKILL)
        first.communicate()
        assert sequences_of_poses(folder) >= kept >= set(range(200))
        number += 1
        second = start(folder)
        await_recorder(bus)
        bus.publish("hider/pose", pose(number))
        await_recorder(bus, uptime=1.0)
        second.send_signal(signal.SIGTERM)
        assert second.wait(PATIENCE) == 0
    assert len(find_logs(folder / "logs")) == 2
    newest = max((folder / "logs").iterdir(), key=lambda path: path.stat().st_mtime)
    assert number in {record.sequence for record in read(newest) if record.key == "hider/pose"}


@pytest.mark.stack
def test_a_folder_that_cannot_be_written_is_said_in_health(folder: Path) -> None:
    (folder / "file").write_text("in the way")
    recorder = start(folder, "--logs", str(folder / "file"))
    with ZenohBus("simulator", folder) as bus:
        bus.subscribe("health/recorder")
        health = await_recorder(bus, state="degraded")
        assert f"{folder / 'file'}: " in health.reason
        (folder / "file").unlink()
        await_recorder(bus)
        recorder.send_signal(signal.SIGTERM)
        assert recorder.wait(2.0) == 0
    assert len(find_logs(folder / "file")) == 1


@pytest.mark.stack
@pytest.mark.parametrize(
    ("options", "told"),
    [(("--readable-by", "all"), "--readable-by"), (("--split-megabytes", "many"), "--split-megabytes")],
)
def test_what_is_wrong_is_said_at_the_start(folder: Path, options: tuple[str, ...], told: str) -> None:
    recorder = start(folder, *options)
    _, said = recorder.communicate(timeout=PATIENCE)
    assert recorder.returncode != 0
    assert told in said
    assert "Traceback" not in said
