"""A participant in a process of its own: `python bus_participant.py FOLDER NAME ROLE [KEY ...]`, JSON lines on stdout.

The environment variable WALL_CLOCK_SET_BY holds the seconds by which its wall clock differs from the machine's.
"""

import json
import os
import sys
import threading
import time
from pathlib import Path

SET_BY = round(1e9 * float(os.environ.get("WALL_CLOCK_SET_BY", "0")))
true_time_ns = time.time_ns
time.time_ns = lambda: true_time_ns() + SET_BY  # before anything reads it

from bus_tables import CALLS, TOPICS, pose, question  # noqa: E402

from schemas import ColorImage, Intrinsics, MalformedMessage  # noqa: E402
from vantage.bus import Lost, Request, Sample  # noqa: E402
from vantage.bus.zenoh_bus import ZenohBus  # noqa: E402


def say(*words: object) -> None:
    print(json.dumps(words), flush=True)


def listen(bus: ZenohBus, keys: list[str]) -> None:
    """Say everything that comes."""
    bus.subscribe(*keys)
    say("ready")
    while True:
        event = bus.receive(10.0)
        if isinstance(event, Sample):
            try:
                say("sample", event.key, event.publisher, event.sequence, event.decode().stamp)
            except MalformedMessage:
                say("malformed", event.key, event.publisher, event.sequence, 0)
        elif isinstance(event, Lost):
            say("lost", event.key, event.publisher, event.missed)


def hold(bus: ZenohBus, keys: list[str]) -> None:
    """Serve, take questions, and never answer."""
    bus.serve("question")
    say("ready")
    questions = []
    while True:
        event = bus.receive(10.0)
        if isinstance(event, Request):
            questions.append(event)
            say("asked", event.token)


def latch(bus: ZenohBus, keys: list[str]) -> None:
    """Publish on each key three times and stay."""
    for key in keys:
        for stamp in (1, 2, 3):
            bus.publish(key, pose(stamp))
    say("ready")
    threading.Event().wait()


def count(bus: ZenohBus, keys: list[str]) -> None:
    """Publish on each key once a millisecond, for ever."""
    say("ready")
    stamp = 0
    while True:
        for key in keys:
            bus.publish(key, pose(stamp))
        stamp += 1
        time.sleep(0.001)


def forget(bus: ZenohBus, keys: list[str]) -> None:
    """Use everything, and end without closing."""
    bus.subscribe("**")
    bus.watch()
    bus.call("question", question(1), 30.0)
    intrinsics = Intrinsics(fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    bus.publish("picture", ColorImage(stamp=1, width=1, height=1, intrinsics=intrinsics, data=bytes(3)))
    bus.publish("newest", pose(1))
    say("ready")


def fail(bus: ZenohBus, keys: list[str]) -> None:
    """End by an exception, without closing."""
    forget(bus, keys)
    raise RuntimeError("an error nobody catches")


if __name__ == "__main__":
    folder, name, role, *keys = sys.argv[1:]
    {f.__name__: f for f in (listen, hold, latch, count, forget, fail)}[role](
        ZenohBus(name, Path(folder), topics=TOPICS, calls=CALLS), keys
    )
