"""How fast the recorder is: `python benchmarks/recorder.py`; `--help` shows the settings.

The writer: the recorder's writer against mcap's own writer, on the same bytes (goal: at least 70 % of its rate).
The path: publisher -> Zenoh -> recorder process -> file, with two 640 x 480 RGB-D streams at 30 Hz and every small topic of a
game (goal: nothing lost).
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import psutil
import tyro
from mcap.writer import CompressionType, Writer

from schemas import (
    GOAL_COUNT,
    ROBOTS,
    ColorImage,
    Command,
    DepthImage,
    Episode,
    Health,
    Intrinsics,
    Layout,
    Message,
    Plan,
    Pose,
    PredictReply,
    StateImage,
    Tick,
    encode,
)
from services.recorder.appearance import arena_appearance
from vantage.bus import Bus, Sample
from vantage.bus.zenoh_bus import ZenohBus
from vantage.log import LogWriter, RunMetadata, find_logs, open_log
from vantage.log.viewer import Viewer

RATE = 30.0
LENS = Intrinsics(fx=343.1, fy=343.1, cx=319.5, cy=239.5)


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    writer: bool = True
    """The writer alone."""
    path: bool = True
    """The whole path."""
    seconds: float = 20.0
    """Of the whole path."""
    viewer: bool = True
    """The recorder writes viewer channels beside, as it does by default."""


def depth_image(number: int) -> DepthImage:
    """A slanted wall with the noise of an RGB-D camera: uint16 [480, 640], mm."""
    generator = np.random.default_rng(number)
    wall = np.linspace(500, 900, 640, dtype=np.float32)[None, :] + generator.normal(0, 2, (480, 640)).astype(np.float32)
    data = wall.astype("<u2").tobytes()
    return DepthImage(stamp=time.time_ns(), step=number, width=640, height=480, intrinsics=LENS, data=data)


def color_image(number: int) -> ColorImage:
    """A shaded wall with camera noise: uint8 [480, 640, 3]."""
    generator = np.random.default_rng(number)
    data = (120 + 10 * generator.standard_normal((480, 640, 3), dtype=np.float32)).astype(np.uint8).tobytes()
    return ColorImage(stamp=time.time_ns(), step=number, width=640, height=480, intrinsics=LENS, data=data)


def workloads() -> dict[str, list[tuple[str, bytes]]]:
    """Name -> (key, payload) in order."""
    pose = encode(Pose(stamp=1, x=0.1, y=0.2, heading=0.3))
    view = encode(StateImage(stamp=1, data=np.repeat(np.arange(4, dtype=np.uint8), 4096).tobytes()))
    cameras = [
        (key, encode(make(n))) for n in range(4) for key, make in (("hider/depth", depth_image), ("hider/color", color_image))
    ]
    return {
        "poses": [("hider/pose", pose), ("seeker/pose", pose)] * 100_000,
        "state images": [("hider/view", view)] * 5_000,
        "640 x 480 RGB-D": cameras * 25,
    }


def write_with_mcap(path: Path, messages: list[tuple[str, bytes]], compression: CompressionType) -> None:
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        channels = {key: writer.register_channel(key, "msgpack", 0) for key, _ in dict.fromkeys(messages)}
        for number, (key, payload) in enumerate(messages):
            writer.add_message(channels[key], log_time=number, data=payload, publish_time=number, sequence=number)
        writer.finish()


def write_with_ours(
    path: Path, messages: list[tuple[str, bytes]], compression: str, sync: bool = False, viewer: bool = False
) -> None:
    translate = Viewer(arena_appearance()).translate if viewer else None
    with LogWriter(path, RunMetadata(), compression=compression, sync=sync, viewer=translate) as writer:  # type: ignore[arg-type]
        for number, (key, payload) in enumerate(messages):
            writer.write(key, payload, log_time=number + 1, publish_time=number, sequence=number, publisher="simulator")


def best_of(times: int, folder: Path, *writes: Callable[[Path], None]) -> list[float]:
    """Seconds of the fastest run of each, taken in turns, so that a busy machine is busy for all of them."""
    durations: list[list[float]] = [[] for _ in writes]
    for _ in range(times):
        for taken, write in zip(durations, writes, strict=True):
            path = folder / "log.mcap"
            start = time.perf_counter()
            write(path)
            taken.append(time.perf_counter() - start)
            path.unlink()
    return [min(taken) for taken in durations]


def measure_writer() -> None:
    print(f"{'workload':<18}{'compression':<13}{'mcap':>13}{'recorder':>13}{'ratio':>7}   {'with viewer channels':>20}")
    kinds = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for workload, messages in workloads().items():
            size = sum(len(payload) for _, payload in messages) / 1e6
            for compression, kind in kinds.items():
                durations = best_of(
                    5,
                    folder,
                    partial(write_with_mcap, messages=messages, compression=kind),
                    partial(write_with_ours, messages=messages, compression=compression),
                    partial(write_with_ours, messages=messages, compression=compression, viewer=True),
                )
                counted = workload == "poses"
                raw, ours, shown = (
                    f"{len(messages) / t / 1e3:.0f} k/s" if counted else f"{size / t:.0f} MB/s" for t in durations
                )
                ratio = durations[0] / durations[1]
                print(f"{workload:<18}{compression:<13}{raw:>13}{ours:>13}{ratio:>7.2f}   {shown:>20}")


PUBLISHERS = ("simulator", "referee", "seeker", "planner", "predictor")


def say_everything_small(buses: dict[str, Bus], number: int) -> int:
    """Publish one message of every small topic of a simulated table (health apart, which is the runtime's); return how many."""
    pose = Pose(stamp=time.time_ns(), episode=1, step=number, x=0.6, y=0.6, heading=math.sin(0.1 * number))
    common = {"stamp": pose.stamp, "episode": 1, "step": number}
    goals = tuple(float(goal) for goal in range(GOAL_COUNT))
    said: list[tuple[str, str, Message]] = [
        ("referee", "tick", Tick(**common)),
        ("referee", "episode", Episode(**common, seed=1, phase="running")),
        ("simulator", "layout", Layout(**common)),
        ("planner", "hider/plan", Plan(**common, horizon=100, values=goals, goal=7, path=bytes(1212))),
        ("predictor", "predictor/reply", PredictReply(**common, caught=bytes(4 * 121 * 10))),
    ]
    for robot, driver in (("hider", "planner"), ("seeker", "seeker")):
        said.append(("simulator", f"{robot}/pose", pose))
        said.append((driver, f"{robot}/command", Command(**common, primitive="forward")))
        said.append((driver, f"{robot}/view", StateImage(**common, data=bytes(128 * 128))))
    for name, key, message in said:
        buses[name].publish(key, message)
    return len(said)


def await_recorder(bus: Bus, settled: int) -> None:
    """Wait until the recorder is up, and has received or given up `settled` messages (health apart)."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        event = bus.receive(1.0)
        if not isinstance(event, Sample) or event.key != "health/recorder":
            continue
        health = event.decode()
        assert isinstance(health, Health)
        done = sum(each.received + each.lost for each in health.inputs if not each.key.startswith(("health/", "gap")))
        if done >= settled and health.uptime > 1.0 and bus.has_reader("hider/depth"):
            return
    print("  the recorder has not settled within a minute")


def measure_path(seconds: float, viewer: bool) -> bool:
    """Return whether nothing was lost."""
    pictures = [(depth_image(n), color_image(n)) for n in range(8)]
    with tempfile.TemporaryDirectory(prefix="vb") as name, ExitStack() as stack:
        folder = Path(name)
        command = [sys.executable, "-m", "services.recorder", "--folder", name, "--logs", str(folder / "logs")]
        recorder = stack.enter_context(
            subprocess.Popen([*command, "--viewer" if viewer else "--no-viewer"], stderr=subprocess.DEVNULL)
        )
        stack.callback(recorder.kill)
        buses: dict[str, Bus] = {each: stack.enter_context(ZenohBus(each, folder)) for each in PUBLISHERS}
        simulator = buses["simulator"]
        simulator.subscribe("health/recorder")
        await_recorder(simulator, 0)
        process = psutil.Process(recorder.pid)
        busy = -sum(process.cpu_times()[:2])
        published, rounds, behind, start = 0, 0, 0.0, time.monotonic()
        while time.monotonic() - start < seconds:
            depth, color = pictures[rounds % len(pictures)]
            for robot in ROBOTS:
                simulator.publish(f"{robot}/depth", depth)
                simulator.publish(f"{robot}/color", color)
            published += 4 + say_everything_small(buses, rounds)
            rounds += 1
            spare = start + rounds / RATE - time.monotonic()
            behind = max(behind, -spare)
            time.sleep(max(0.0, spare))
        took = time.monotonic() - start
        busy += sum(process.cpu_times()[:2])
        memory = process.memory_info().rss
        await_recorder(simulator, published)
        recorder.send_signal(signal.SIGTERM)
        recorder.wait()
        print(
            f"\nwhole path: two 640 x 480 RGB-D streams at {rounds / took:.1f} Hz for {took:.1f} s; "
            f"publisher at most {behind:.2f} s late"
        )
        print(f"  recorder: {100 * busy / took:.0f} % of one core, {memory / 1e6:.0f} MB resident")
        return nothing_lost(folder / "logs", published, took)


def nothing_lost(logs: Path, published: int, took: float) -> bool:
    """Count what is in the log beside what was published."""
    recorded, missing, noted = 0, 0, 0
    last: dict[tuple[str, str], int] = {}
    with open_log(*find_logs(logs)[0]) as log:
        for record in log.records():
            if record.key == "gap":
                noted += 1
            elif not record.key.startswith("health/"):
                recorded += 1
                name = (record.key, record.publisher)
                missing += record.sequence - last.get(name, -1) - 1
                last[name] = record.sequence
        size = sum(file.path.stat().st_size for file in log.files)
    print(
        f"  published {published}, recorded {recorded}, missing by sequence {missing}, losses noted {noted}; "
        f"{size / took / 1e6:.0f} MB/s"
    )
    return recorded == published and not missing and not noted


def main(settings: Settings) -> int:
    """Exit code 1 when something was lost."""
    if settings.writer:
        measure_writer()
    return 0 if not settings.path or measure_path(settings.seconds, settings.viewer) else 1


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
