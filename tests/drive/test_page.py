"""docs/robot-protocol.md: its examples are made by the code, and its way onto the bus leads there."""

from __future__ import annotations

import json
import re
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from socket import socket

import msgpack
import pytest
import zenoh

from schemas import Motion, encode
from tests.drive.examples import COMMAND, MOTION, PAGE, STAMP, STARTED, with_examples
from vantage.bus import Alive, Bus, Sample
from vantage.bus.zenoh_bus import ZenohBus
from vantage.bus.zenoh_events import pack
from vantage.drive.protocol import decode
from vantage.service import Runtime


@pytest.fixture
def short_folder() -> Iterator[Path]:
    """The path of a unix socket has little room."""
    with tempfile.TemporaryDirectory(prefix="vantage-", dir="/tmp") as folder:
        yield Path(folder)


def test_the_examples_are_what_the_code_makes() -> None:
    assert PAGE.read_text() == with_examples(PAGE.read_text()), "run python -m tests.drive.examples"


def test_every_line_shown_is_a_line() -> None:
    shown = re.findall(r"^(?:driver|robot): *(\$.*)$", PAGE.read_text(), re.MULTILINE)
    assert len(shown) >= 10
    for text in shown:
        decode(text.encode() + b"\n")


def test_the_dumps_are_messagepack_for_another_reader() -> None:
    """Read off the page, by a library that is not ours."""
    blocks = re.findall(r"```\n(0000.*?)```", PAGE.read_text(), re.DOTALL)
    dumps = [bytes.fromhex("".join(row[6:53] for row in block.splitlines())) for block in blocks]
    maps = [msgpack.unpackb(data) for data in dumps if data[0] >> 4 == 8]
    assert maps[0] == {"stamp": STAMP, "episode": 3, "step": 41, "primitive": "forward"}
    assert maps[1]["result"] == MOTION.result and maps[1]["battery"] == MOTION.battery
    assert struct.unpack("<QQQ", dumps[-1][:24]) == (42, STAMP, STARTED) and dumps[-1][24:] == b"onboard"


def wait(bus: Bus, found: Callable[[object], bool]) -> list[object]:
    events: list[object] = []
    deadline = time.monotonic() + 120.0
    while not (events and found(events[-1])):
        assert time.monotonic() < deadline, events
        event = bus.receive(0.2)
        if event is not None:
            events.append(event)
    return events


def test_a_plain_zenoh_client_takes_part_through_the_gateway_of_the_page(short_folder: Path) -> None:
    with socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shown = re.search(r"```json\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert shown is not None
    configuration = shown[1].replace("FOLDER", str(short_folder)).replace("ADDRESS:7447", f"127.0.0.1:{port}")
    client = {
        "mode": "client",
        "connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]},
        "scouting": {"multicast": {"enabled": False}},
    }
    with ZenohBus("planner", short_folder) as planner, ZenohBus("tracker", short_folder) as tracker:
        tracker.subscribe("hider/motion")
        tracker.watch()
        with (
            zenoh.open(zenoh.Config.from_json5(configuration)),
            zenoh.open(zenoh.Config.from_json5(json.dumps(client))) as robot,
        ):
            commands = robot.declare_subscriber("vantage/table/hider/command")
            token = robot.liveliness().declare_token("vantage-alive/table/onboard")
            wait(tracker, lambda event: event == Alive("onboard", True))
            deadline = time.monotonic() + 120.0
            while (heard := commands.try_recv()) is None:
                assert time.monotonic() < deadline
                planner.publish("hider/command", COMMAND)
                time.sleep(0.05)
            assert msgpack.unpackb(heard.payload.to_bytes())["primitive"] == "forward"
            assert encode(COMMAND) == heard.payload.to_bytes()

            motions = robot.declare_publisher("vantage/table/hider/motion")
            motions.put(encode(MOTION))
            motions.put(encode(MOTION), attachment=pack(0, STAMP, struct.pack("<Q", STARTED) + b"onboard"))
            events = wait(tracker, lambda event: isinstance(event, Sample) and event.publisher == "onboard")
            strangers = [event for event in events if isinstance(event, Sample) and event.publisher == ""]
            assert len(strangers) == 1
            own = events[-1]
            assert isinstance(own, Sample) and own.decode() == MOTION
            token.undeclare()


def test_a_motion_without_attachment_is_set_aside_and_said(short_folder: Path) -> None:
    """What the page says of it, by the runtime of a service that hears motions."""
    from services.tracker.declaration import DECLARATION

    class Listener:
        declaration = DECLARATION

        def __init__(self) -> None:
            self.heard: list[object] = []

        def step(self, received: object, now: int) -> tuple[()]:
            self.heard.append(received)
            return ()

        def wake_at(self) -> None:
            return None

    with ZenohBus("tracker", short_folder) as bus:
        core = Listener()
        runtime = Runtime(core, bus, health=False)
        bus.post(Sample("hider/motion", encode(MOTION), "", 0, STAMP, Motion))
        deadline = time.monotonic() + 120.0
        while "stranger" not in (reason := runtime.health_report("ok").reason):
            assert time.monotonic() < deadline
            runtime.turn(0.1)
        assert "set aside: hider/motion from a stranger, who may not publish it" in reason
        assert not any(getattr(event, "key", "") == "hider/motion" for event in core.heard)
