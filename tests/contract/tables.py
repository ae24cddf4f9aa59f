"""Tables that keep one contract, in process and in virtual time: the simulator, and a real table's processes rehearsed."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from schemas import ROBOTS, Command, Episode, Message, Pose, Rules, Tick
from services.rehearsal.cameras import Cameras
from services.rehearsal.core import CAMERAS, LINES, CameraSettings, RehearsalCore
from services.rehearsal.preparation import Prepared, TableSettings, calibrate_and_write, prepare_table
from services.rehearsal.world import World
from services.robot.core import RobotCore
from services.robot.settings import RobotSettings
from services.simulator.core import SimulatorCore, SimulatorSettings
from services.tracker.calibrated import CalibrationFiles, CalibrationSettings
from services.tracker.core import Calibrated, TrackerCore
from vantage.bus import Bus, InProcessNetwork, Sample, VirtualClock
from vantage.service import SECOND, Captured, Runtime, run_in_process
from vantage.tracking.rgbd import default_rgbd
from vantage.tracking.rgbd_lens import lens_of
from vantage.world.camera import Camera

LAYOUT_SEED = 1
OVERHEAD_SIZE = (960, 540)
SMALL_CAMERA = msgspec.structs.replace(
    default_rgbd(), depth=lens_of(320, 240, math.radians(87.0)), color=lens_of(320, 240, math.radians(90.0))
)
"""Cameras that see what the rehearsal's see, in fewer pixels: pictures to be drawn are what these tests wait for."""
WORLD_KEYS = ("layout", *(f"{robot}/{part}" for robot in ROBOTS for part in ("pose", "depth", "color", "track", "motion")))


@dataclass
class CableEnd:
    """One end of a serial cable between two services: a device whose writes come out at the other end."""

    name: str
    other: Bus
    other_name: str
    clock: Callable[[], int]
    newest_only: bool = False
    cut: bool = False

    def write(self, data: bytes) -> None:
        if not self.cut:
            self.other.post(Captured(self.other_name, data, self.clock()))

    def open(self) -> None: ...
    def read(self) -> None: ...
    def close(self) -> None: ...


@dataclass
class CamerasAtOnce:
    """The rehearsed cameras, which draw a frame in the moment of its exposure."""

    cameras: Cameras
    session: Bus
    clock: Callable[[], int]
    name: str = CAMERAS
    newest_only: bool = False

    def write(self, data: bytes) -> None:
        self.session.post(Captured(CAMERAS, self.cameras.draw(data), self.clock()))

    def open(self) -> None: ...
    def read(self) -> None: ...
    def close(self) -> None: ...


class TableOnTest:
    """A table, and everybody who talks to it: the test itself is referee, planner and seeker."""

    def __init__(self) -> None:
        self.network = InProcessNetwork(clock=VirtualClock(), checked=True)
        self.clock = self.network.clock
        self.sessions = {name: self.network.session(name) for name in ("referee", "planner", "seeker", "recorder")}
        self.sessions["recorder"].subscribe(*WORLD_KEYS, raw=True)
        self.said: list[Sample] = []
        self.runtimes: list[Runtime] = []

    def run(self, until: Callable[[], bool], seconds: float) -> bool:
        """Let the table run until something is so, or this much time has passed. Returns whether it came to be so."""
        deadline = self.clock() + int(seconds * SECOND)

        def enough() -> bool:
            while (event := self.sessions["recorder"].receive(0.0)) is not None:
                if isinstance(event, Sample):
                    self.said.append(event)
            return until() or self.clock() >= deadline

        with contextlib.suppress(RuntimeError):  # a table that only reacts has nothing left to do
            run_in_process(self.network, self.runtimes, enough)
        return until()

    def messages(self, key: str, episode: int) -> list[Any]:
        """What was said on a key of an episode, in order."""
        return [message for sample in self.said if sample.key == key and (message := sample.decode()).episode == episode]

    def has_step(self, episode: int, step: int) -> bool:
        return all(any(pose.step == step for pose in self.messages(f"{robot}/pose", episode)) for robot in ROBOTS)

    def publish(self, who: str, key: str, message: Message) -> None:
        self.sessions[who].publish(key, message)

    def phase(self, number: int, phase: str, seed: int = LAYOUT_SEED, **rules: Any) -> None:
        """Be the referee: say how an episode stands."""
        episode = Episode(
            stamp=self.clock(),
            episode=number,
            seed=seed,
            phase=phase,  # type: ignore[arg-type]
            rules=Rules(layout="lab", **rules),
        )
        self.publish("referee", "episode", episode)

    def begin(self, number: int, seed: int = LAYOUT_SEED, patience: float = 40.0, **rules: Any) -> None:
        """Set a game up and wait for its first poses."""
        self.phase(number, "setup", seed, **rules)
        assert self.run(lambda: self.has_step(number, 0), patience), f"no step 0 of episode {number}: {self.troubles()}"
        self.phase(number, "running", seed, **rules)
        self.publish_tick(number, 0)

    def publish_tick(self, number: int, step: int) -> None:
        self.publish("referee", "tick", Tick(stamp=self.clock(), episode=number, step=step))

    def command(self, number: int, step: int, **primitives: str) -> None:
        """Be the players: say what the named robots do."""
        for robot, primitive in primitives.items():
            command = Command(stamp=self.clock(), episode=number, step=step, primitive=primitive)  # type: ignore[arg-type]
            self.publish("planner" if robot == "hider" else "seeker", f"{robot}/command", command)

    def move(self, number: int, step: int, hider: str, seeker: str, patience: float = 3.0) -> None:
        """Have both robots do something, wait for the poses that follow, and tick: within the referee's patience."""
        self.command(number, step, hider=hider, seeker=seeker)
        assert self.run(lambda: self.has_step(number, step + 1), patience), f"no step {step + 1}: {self.troubles()}"
        self.publish_tick(number, step + 1)

    def step_of(self, key: str, episode: int, step: int) -> Any:
        """The one message of a key for a step."""
        (message,) = (message for message in self.messages(key, episode) if message.step == step)
        return message

    def poses(self, episode: int, step: int) -> tuple[Pose, Pose]:
        hider, seeker = (self.step_of(f"{robot}/pose", episode, step) for robot in ROBOTS)
        return hider, seeker

    def troubles(self) -> list[str]:
        return [runtime.health_report("ok").reason for runtime in self.runtimes]


class SimulatedTable(TableOnTest):
    """The simulator."""

    place_error, angle_error = 1e-9, 1e-9

    def __init__(self) -> None:
        super().__init__()
        self.restart()

    def restart(self) -> None:
        """Have the process that publishes the world die and come again."""
        for runtime in self.runtimes:
            runtime.bus.close()
        core = SimulatorCore(SimulatorSettings(camera=Camera(width=160, height=120)))
        self.runtimes = [Runtime(core, self.network.session("simulator"), self.clock)]


@dataclass(frozen=True)
class Calibration:
    """A rehearsed table and what the calibration of its cameras found."""

    prepared: Prepared
    calibrated: Calibrated


def calibrate(folder: Path) -> Calibration:
    prepared = prepare_table(TableSettings("lab", LAYOUT_SEED), OVERHEAD_SIZE, SMALL_CAMERA)
    calibrate_and_write(prepared, folder, seed=1)
    table, overhead, hider, seeker = (folder / f"{name}.json" for name in ("table", "overhead", "hider", "seeker"))
    files = CalibrationFiles(CalibrationSettings(table, overhead, hider, seeker), *OVERHEAD_SIZE)
    return Calibration(prepared, files.load())


class RehearsedTable(TableOnTest):
    """Tracker and driver at a table that the rehearsal stands for."""

    place_error, angle_error = 0.004, 0.06

    def __init__(self, calibration: Calibration) -> None:
        super().__init__()
        prepared, self.calibrated = calibration.prepared, calibration.calibrated
        self.obstacles = prepared.obstacles
        self.world = World(prepared.obstacles, prepared.starts, seed=1)
        rehearsal = RehearsalCore(self.world, CameraSettings())
        sessions = {name: self.network.session(name) for name in ("rehearsal", "robot", "tracker")}
        self.cables: dict[str, list[CableEnd]] = {
            "rehearsal": [CableEnd(line, sessions["robot"], robot, self.clock) for line, robot in LINES.items()],
            "robot": [CableEnd(robot, sessions["rehearsal"], line, self.clock) for line, robot in LINES.items()],
        }
        cameras = Cameras(prepared.obstacles, prepared.scene, prepared.cameras, CameraSettings().seed)
        drawn = CamerasAtOnce(cameras, sessions["rehearsal"], self.clock)
        robot = RobotCore(RobotSettings(hider_port="cable", seeker_port="cable"))
        self.runtimes = [
            Runtime(rehearsal, sessions["rehearsal"], self.clock, devices=[*self.cables["rehearsal"], drawn]),
            Runtime(robot, sessions["robot"], self.clock, devices=self.cables["robot"]),
            Runtime(TrackerCore(self.calibrated), sessions["tracker"], self.clock),
        ]

    def unplug(self, *names: str) -> None:
        """Pull plugs, and put all others in."""
        self.runtimes[0].bus.post(Captured("faults", frozenset(names), self.clock()))
        for cable in (*self.cables["rehearsal"], *self.cables["robot"]):
            cable.cut = cable.name in names or cable.other_name in names

    def restart(self) -> None:
        """Have the tracker die and come again."""
        self.runtimes[2].bus.close()
        self.runtimes[2] = Runtime(TrackerCore(self.calibrated), self.network.session("tracker"), self.clock)
