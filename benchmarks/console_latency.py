"""From the bus to the pixel: how long until what a service published is drawn in a real browser.

    python benchmarks/console_latency.py

First part. A process of its own publishes 128 x 128 state images and 320 x 240 colour pictures on a Zenoh bus; the console is the
real process. By turns, in the same run, the reader is a plain WebSocket client (until the message is there) and Chromium with the
real page (until the display frame in which it was drawn is done; the page notes whole milliseconds, which are counted up). The
ratio of both is what the browser adds. Compositor and screen come after that and are not in it.

Second part. A game runs with pictures of 320 x 240, and the browser, all its processes, is stopped for ten seconds. Said are:
games lost, messages lost by any service, ways on the bus before, during and after, and how soon the page shows the present again.
A page that answers no ping for some seconds is cut off, for it might drive: the browser has to connect again by itself first.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import tyro
from playwright.sync_api import Browser, Page, sync_playwright

from schemas import ColorImage, Episode, StateImage
from tests.services.console_arena import Arena
from tests.services.console_socket import Socket, Target
from vantage.bus.zenoh_bus import ZenohBus
from vantage.deployment import CONSOLE_ADDRESS
from vantage.world.camera import Camera

ROOT = Path(__file__).resolve().parents[1]
COLOR, VIEW = "hider/color", "hider/view"
BACK = 5.0
"""Seconds in which the page has to be there again, connected anew."""
NAMES = {VIEW: "state image 128 x 128", COLOR: "colour 320 x 240"}


@dataclass
class Settings:
    """What is measured."""

    seconds: float = 10.0
    """of each turn"""
    turns: int = 3
    rate: float = 30.0
    """of each of the two pictures, a second"""
    stopped: float = 10.0
    """seconds for which the browser is stopped"""


def publish(folder: Path, rate: float, ready: Event, stop: Event) -> None:
    """Publish a running game's pictures at a rate, until stopped: a process of its own."""
    source = np.random.default_rng(1)
    camera = Camera(width=320, height=240)
    pictures = [source.integers(0, 256, 320 * 240 * 3, np.uint8).tobytes() for _ in range(8)]
    views = [source.integers(0, 5, 128 * 128, np.uint8).tobytes() for _ in range(8)]
    with ZenohBus("referee", folder) as referee, ZenohBus("simulator", folder) as world, ZenohBus("planner", folder) as planner:
        referee.publish("episode", Episode(stamp=time.time_ns(), episode=1, seed=1, phase="running"))
        due, number = time.monotonic(), 0
        while not stop.is_set():
            number = number + 1
            common: dict[str, Any] = {"episode": 1, "step": number % 100_000}
            planner.publish(VIEW, StateImage(stamp=time.time_ns(), data=views[number % 8], **common))
            size = {"width": 320, "height": 240, "intrinsics": camera.intrinsics()}
            world.publish(COLOR, ColorImage(stamp=time.time_ns(), data=pictures[number % 8], **size, **common))
            ready.set()
            due += 1.0 / rate
            time.sleep(max(0.0, due - time.monotonic()))


@contextmanager
def console(folder: Path) -> Iterator[Target]:
    """The real console on a free port."""
    command = [sys.executable, "-m", "services.console", "--folder", str(folder), "--port", "0"]
    log = folder / "console.log"
    running = subprocess.Popen(command, cwd=ROOT, stderr=log.open("w"))
    try:
        address = folder / CONSOLE_ADDRESS
        end = time.monotonic() + 60.0
        while not address.is_file():
            if time.monotonic() > end or running.poll() is not None:
                raise RuntimeError(f"the console gives no address: {log.read_text()[-2000:]}")
            time.sleep(0.02)
        yield Target.at(address.read_text().strip())
    finally:
        running.terminate()
        running.wait(10.0)


@contextmanager
def chromium() -> Iterator[Browser]:
    """A real browser without a window."""
    path = shutil.which("chromium")
    if path is None:
        raise SystemExit("this needs `chromium` on the path: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


def plain(target: Target, seconds: float) -> dict[str, list[float]]:
    """Return ms from stamp to receipt of a WebSocket client that does nothing else."""
    found: dict[str, list[float]] = {COLOR: [], VIEW: []}
    with Socket(target) as opened:
        begin = time.time_ns()
        while time.time_ns() - begin < seconds * 1e9:
            _, data = opened.receive()
            at = time.time_ns()
            header = json.loads(data[4 : 4 + int.from_bytes(data[:4], "little")])
            if header["key"] in found and int(header["stamp"]) > begin:
                found[header["key"]].append((at - int(header["stamp"])) / 1e6)
    return found


def drawn(browser: Browser, target: Target, seconds: float) -> dict[str, list[float]]:
    """Return ms from stamp to the end of the display frame in which the page drew it."""
    found: dict[str, list[float]] = {COLOR: [], VIEW: []}
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    try:
        page.goto(f"http://{target.name}/")
        page.wait_for_function(f"() => window.vantage.painted.filter(([key]) => key === '{COLOR}').length > 30")
        begin = time.time_ns()
        while time.time_ns() - begin < seconds * 1e9:
            page.wait_for_timeout(1000)
            for key, stamp, at in page.evaluate("() => window.vantage.painted.splice(0)"):
                if key in found and int(stamp) > begin:
                    found[key].append(at + 1 - int(stamp) / 1e6)
    finally:
        page.close()
    return found


def percentile(values: list[float], share: float) -> float:
    return float(np.percentile(values, 100 * share)) if values else float("nan")


def first_part(settings: Settings) -> None:
    with tempfile.TemporaryDirectory(prefix="vl-") as name:
        folder = Path(name)
        folder.chmod(0o700)
        spawning = multiprocessing.get_context("spawn")
        ready, stop = spawning.Event(), spawning.Event()
        publisher = spawning.Process(target=publish, args=(folder, settings.rate, ready, stop), daemon=True)
        publisher.start()
        ready.wait(60.0)
        ways: dict[str, dict[str, list[float]]] = {"plain client": {}, "Chromium": {}}
        with console(folder) as target, chromium() as browser:
            plain(target, 1.0)
            for turn in range(settings.turns):
                print(f"\rturn {turn + 1} of {settings.turns}", end="", file=sys.stderr, flush=True)
                sides = {"plain client": plain(target, settings.seconds), "Chromium": drawn(browser, target, settings.seconds)}
                for side, found in sides.items():
                    for key, values in found.items():
                        ways[side].setdefault(key, []).extend(values)
        print(file=sys.stderr)
        stop.set()
        publisher.join(10.0)
    expected = settings.turns * settings.seconds * settings.rate
    print(f"bus to pixel, {settings.rate:g} Hz each, {settings.turns} turns of {settings.seconds:g} s on {os.cpu_count()} cores")
    print(f"  {'':22} {'':14} {'p50 ms':>8} {'p95 ms':>8} {'shown':>7}")
    for key, label in NAMES.items():
        medians = []
        for side, found in ways.items():
            values = found[key]
            medians.append(percentile(values, 0.5))
            share = f"{len(values) / expected:.0%}"
            print(f"  {label:22} {side:14} {medians[-1]:8.1f} {percentile(values, 0.95):8.1f} {share:>7}")
        print(f"  {label:22} {'ratio of p50':14} {medians[1] / medians[0]:8.1f}")


def processes_of(browser_name: str) -> list[psutil.Process]:
    """All processes of the browser that this program started."""
    return [process for process in psutil.Process().children(recursive=True) if browser_name in process.name()]


def second_part(settings: Settings) -> int:
    with Arena(period=0.1, host="127.0.0.1", camera=Camera(width=320, height=240)) as arena, chromium() as browser:
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(f"http://{arena.target.name}/#token={arena.target.token}")
        page.wait_for_function("() => window.vantage.painted.length > 50")
        page.wait_for_timeout(2000)
        arena.bus_ticks.begin()
        arena.page_ticks.begin()
        ways: dict[str, list[float]] = {}

        def measure(name: str, seconds: float) -> None:
            began = len(arena.ways)
            time.sleep(seconds)
            ways[name] = arena.ways[began:]

        measure("before", 5.0)
        lag_before = statistics.median(lag for _, lag in page.evaluate(LAGS))
        stopped = processes_of("chrom")
        print(f"stopping {len(stopped)} processes of the browser for {settings.stopped:g} s", file=sys.stderr)
        for process in stopped:
            process.send_signal(signal.SIGSTOP)
        try:
            measure("during", settings.stopped)
            assert any(process.status() == psutil.STATUS_STOPPED for process in stopped)
        finally:
            for process in reversed(stopped):
                process.send_signal(signal.SIGCONT)
        back, lag = present_again(page)
        measure("after", 5.0)
        lost = {service: count for service, count in arena.lost.items() if count}
        ended = sorted(phase for _, phase in arena.episodes if phase in ("ended", "aborted"))
        print(f"the browser stopped for {settings.stopped:g} s while a game runs (320 x 240, 10 steps a second)")
        print(f"  games ended or aborted: {len(ended)}; messages lost: {lost or 'none'} (of {', '.join(sorted(arena.lost))})")
        for name, values in ways.items():
            spread = f"p50 {1e3 * statistics.median(values):.2f} ms, p95 {1e3 * percentile(values, 0.95):.2f} ms"
            print(f"  way on the bus {name:7} {spread} ({len(values)} messages)")
        longest = f"on the bus {1e3 * arena.bus_ticks.longest:.0f} ms, at another page {1e3 * arena.page_ticks.longest:.0f} ms"
        print(f"  longest time between two ticks (100 ms are due): {longest}")
        lags = f"{lag:.0f} ms after it was made (before the stop: p50 {lag_before:.0f} ms)"
        print(f"  {1e3 * back:.0f} ms after the browser was let go on the page drew a picture made since then, {lags}")
        return int(bool(lost or ended or back > BACK))


LAGS = """() => window.vantage.painted.filter(([key]) => key === 'hider/color')
    .map(([, stamp, at]) => [stamp, at - Number(BigInt(stamp) / 1000000n)])"""
"""Of each picture drawn lately its stamp, and ms from that until it was drawn."""


def present_again(page: Page) -> tuple[float, float]:
    """Return s until the page has drawn a picture that was made after this call, and that picture's own lag in ms."""
    began = time.time_ns()
    while time.time_ns() - began < 30e9:
        for stamp, lag in page.evaluate(LAGS):
            if int(stamp) > began:
                return (int(stamp) - began) / 1e9 + lag / 1e3, lag
        page.wait_for_timeout(10)
    return float("inf"), float("inf")


def main(settings: Settings) -> int:
    first_part(settings)
    return second_part(settings)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
