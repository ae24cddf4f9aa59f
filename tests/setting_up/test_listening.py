"""Judging a running table by what it says: real messages over a bus, with the faults put in."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from schemas import Box, ColorImage, DepthImage, Health, Intrinsics, Layout, Message, Track
from vantage.bus import InProcessNetwork, Sample, VirtualClock
from vantage.deployment import Process
from vantage.setting_up.listening import LISTENED, Heard, Stream, judge_heard, listen, take
from vantage.setting_up.verdict import Verdict, lines

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
LISTENING = 4.0


def process(name: str, pid: int = 7) -> Process:
    return Process(name=name, state="RUNNING", pid=pid, restarts=0, uptime=9.0, memory=1, complaint="")


def health(service: str, stamp: int, reason: str = "", pid: int = 7) -> Health:
    return Health(stamp=stamp, service=service, state="degraded" if reason else "ok", process=pid, uptime=9.0, reason=reason)


def picture(level: int, stamp: int) -> ColorImage:
    data = np.full((4, 6, 3), level, np.uint8).tobytes()
    return ColorImage(stamp=stamp, width=6, height=4, intrinsics=Intrinsics(fx=5.0, fy=5.0, cx=2.5, cy=1.5), data=data)


class Room:
    """A bus with a tracker and a robot driver on it, and somebody who listens for four seconds."""

    def __init__(self) -> None:
        self.clock = VirtualClock(START)
        self.network = InProcessNetwork(clock=self.clock)
        self.speakers = {name: self.network.session(name) for name in ("tracker", "robot", "rehearsal", "planner")}
        self.listener = self.network.session("watch-1")
        self.listener.subscribe(*LISTENED)
        self.heard = Heard()
        self.ahead = 0  # ns by which the speakers' clock is ahead of the listener's

    def hear(self, passed: float, speaker: str, key: str, message: Message, age: float = 0.0) -> None:
        """Let a message of so many seconds of age arrive `passed` seconds after the beginning."""
        self.clock.now = START + round(passed * SECOND) + self.ahead
        stamped = msgspec.structs.replace(message, stamp=self.clock.now - round(age * SECOND))
        self.speakers[speaker].publish(key, stamped)
        while (event := self.listener.receive(0.0)) is not None:
            if isinstance(event, Sample):
                take(self.heard, event, passed, self.clock.now - self.ahead)

    def verdicts(self, boxes: int | None = 1, *processes: Process) -> dict[str, Verdict]:
        self.heard.seconds, self.heard.ended = LISTENING, START + round((LISTENING + 0.3) * SECOND)
        return {verdict.what: verdict for verdict in judge_heard(self.heard, "hardware", list(processes), boxes)}


def played(rate: float = 30.0, age: float = 0.03, unseen: float = 0.0, raw: bool = False, room: Room | None = None) -> Room:
    """Four seconds of a table with both robots tracked."""
    room = room or Room()
    room.hear(0.1, "tracker", "layout", Layout(stamp=0, obstacles=(Box(x=0.5, y=0.5, half_width=0.1, half_depth=0.1),)))
    for index in range(round(rate * LISTENING)):
        at = 0.31 + index / rate
        for robot in ("hider", "seeker"):
            seen = index % 100 >= 100 * unseen
            room.hear(at, "tracker", f"{robot}/track", Track(stamp=0, x=0.3, y=0.4, heading=0.1, seen=seen), age)
        if raw and index % 1 == 0:
            room.hear(at, "rehearsal", "overhead/color", picture(90, 0))
    for service in ("tracker", "robot"):
        room.hear(4.0, service, f"health/{service}", health(service, 0))
    return room


def test_a_table_that_runs_well() -> None:
    verdicts = played().verdicts(1, process("tracker"), process("robot"))
    assert all(verdict.ok for verdict in verdicts.values()), verdicts
    assert verdicts["service robot"].found == "ok, its robots answer"
    assert verdicts["hider/track"].found == "30.0 a second, expected 30"
    assert verdicts["seeker latency"].found.startswith("30 ms from capture")
    assert verdicts["layout"].found == "1 box"


def test_slow_old_and_guessed_tracks_are_told_apart() -> None:
    assert "too slow" in played(rate=9.0).verdicts()["hider/track"].remedy
    assert played(age=0.25).verdicts()["seeker latency"].found.startswith("250 ms")
    assert not played(age=0.25).verdicts()["seeker latency"].ok
    guessed = played(unseen=0.3).verdicts()
    assert [what for what, verdict in guessed.items() if not verdict.ok] == ["hider tag", "seeker tag"]


def test_tracks_come_as_often_as_frames_where_the_frames_are_on_the_bus() -> None:
    room = played(rate=15.0, raw=True)
    assert room.verdicts()["hider/track"].found == "15.0 a second, expected 15"
    assert room.verdicts()["hider/track"].ok
    frame = room.heard.last_picture("overhead/color")
    assert frame is not None and frame.shape == (4, 6, 3) and frame.max() == frame.min() == 90


def test_what_was_kept_from_before_is_no_news() -> None:
    """A late joiner gets the last message of each topic: of a camera that is long gone, too."""
    room = Room()
    room.hear(0.05, "rehearsal", "overhead/color", picture(90, 0), age=60.0)
    room.hear(0.05, "tracker", "hider/track", Track(stamp=0, x=0.3, y=0.4, heading=0.1), age=60.0)
    assert room.heard.last_picture("overhead/color") is None
    verdicts = room.verdicts()
    for key in ("overhead/color", "hider/track", "seeker/track"):
        assert verdicts[key].found == "nothing heard"
        assert not verdicts[key].ok
    assert "hider latency" not in verdicts


def test_services_in_trouble_speak_for_themselves() -> None:
    room = played()
    told = "robot hider does not answer on /dev/rfcomm0: is it switched on, is it the right port?"
    room.hear(4.2, "robot", "health/robot", health("robot", 0, told))
    verdicts = room.verdicts(1, process("tracker", pid=8), process("robot"), process("referee"))
    assert verdicts["service robot"].found == told
    assert "vantage logs robot --deployment hardware" in verdicts["service robot"].remedy
    assert "has not reported yet" in verdicts["service tracker"].found, "its health is of a process that is gone"
    assert "has not reported yet" in verdicts["service referee"].found


def test_a_service_that_fell_silent_is_said() -> None:
    room = Room()
    room.hear(0.2, "robot", "health/robot", health("robot", 0))
    assert "silent" in room.verdicts(None, process("robot"))["service robot"].found


@pytest.mark.parametrize("clock", [-3600.0, -0.5, 0.5, 3600.0])
def test_a_table_that_runs_well_on_a_machine_with_another_clock(clock: float) -> None:
    room = Room()
    room.ahead = round(clock * SECOND)
    verdicts = played(room=room).verdicts(1, process("tracker"), process("robot"))
    assert all(verdict.ok for verdict in verdicts.values()), verdicts
    assert verdicts["seeker latency"].found.startswith("30 ms from capture")
    color, depth = (room.heard.streams.setdefault(f"hider/{part}", Stream(publisher="tracker")) for part in ("color", "depth"))
    taken = START + 2 * SECOND + room.ahead
    lens = Intrinsics(fx=5.0, fy=5.0, cx=2.5, cy=1.5)
    color.last = ColorImage(stamp=taken, width=1, height=1, intrinsics=lens, data=bytes(3))
    depth.last = DepthImage(stamp=taken, width=1, height=1, intrinsics=lens, data=bytes(2))
    pictures = room.heard.robot_pictures("hider", raw=False)
    assert pictures is not None and pictures[2] == pytest.approx(2.3, abs=0.01)


def test_a_machine_that_is_too_slow_is_said() -> None:
    assert "load 0.0 on 1 core, this command woken 0 ms late" in played().verdicts()["machine"].found
    room = played()
    room.heard.load, room.heard.cores, room.heard.late = 3.9, 2, 0.02
    assert room.verdicts()["machine"].ok
    for change in ({"load": 12.3}, {"late": 0.4}):
        room = played()
        room.heard.cores = 2
        for name, value in change.items():
            setattr(room.heard, name, value)
        machine = room.verdicts()["machine"]
        assert "too slow" in machine.remedy and ("load 12.3 on 2 cores" in machine.found or "400 ms late" in machine.found)
    room = played()
    room.hear(
        4.2, "rehearsal", "health/rehearsal", health("rehearsal", 0, "this machine is too slow: it draws 2.0 of 20 pictures")
    )
    assert room.verdicts()["machine"].found.endswith("too slow for rehearsal") and not room.verdicts()["machine"].ok


def test_strangers_and_missing_boxes() -> None:
    room = played()
    room.heard.streams.pop("layout")
    room.hear(4.1, "tracker", "layout", Layout(stamp=0))
    verdicts = room.verdicts(3)
    assert verdicts["layout"].found == "0 boxes"
    assert "has 3" in verdicts["layout"].remedy
    assert "layout" not in Room().verdicts(3)


def test_listening_takes_its_time_and_tells_it() -> None:
    room = Room()
    room.speakers["tracker"].publish("hider/track", Track(stamp=START, x=0.3, y=0.4, heading=0.1))
    told: list[float] = []
    heard = listen(room.listener, 0.2, told.append, room.clock)
    assert told == sorted(told) and told
    assert "hider/track" in heard.streams
    assert (heard.seconds, heard.ended) == (0.2, START)


def test_lines_are_aligned_and_carry_the_remedy() -> None:
    shown = lines([Verdict("a", "fine"), Verdict("longer", "bad [x]", "do this")])
    assert shown[0].startswith("[green]ok     [/]  a       fine")
    assert shown[1] == "[red]trouble[/]  longer  bad \\[x] → do this"


@pytest.mark.parametrize("key", LISTENED)
def test_it_listens_to_topics_that_there_are(key: str) -> None:
    network = InProcessNetwork(clock=VirtualClock(START))
    network.session("watch-2").subscribe(key)


def test_a_service_whose_clock_is_another_is_not_silent() -> None:
    """After a suspend, or on another machine: health is as old as its arrival says."""
    room = played()
    for service, age in (("tracker", 3600.0), ("robot", -3600.0)):
        room.hear(4.1, service, f"health/{service}", health(service, 0), age)
    verdicts = room.verdicts(1, process("tracker"), process("robot"))
    assert verdicts["service tracker"].ok
    assert verdicts["service robot"].ok
