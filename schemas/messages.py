"""Every message of a game on the bus, declared once; those of the running of a table are in `schemas.operation`.

Conventions, for all messages:

* Arena frame: origin at the lower left corner, x right, y up, metres. Headings are radians, counter-clockwise from +x.
* `stamp` is the moment of capture in nanoseconds since the Unix epoch. A message derived from a picture (a state image, a
  command) carries the stamp of that picture.
* Arrays travel as little-endian, C-ordered bytes; the field's description gives dtype and shape.
* Every numeric field is bounded, so that an absurd message is refused when it is decoded (`msgspec.ValidationError`).
* Fields are added (with a default) or retired (see `schemas.evolution`), never re-used with another meaning.
"""

from __future__ import annotations

import math
import struct
from typing import Annotated, Literal

from msgspec import Meta, Struct, field

Robot = Literal["hider", "seeker"]
Primitive = Literal["stay", "forward", "backward", "left", "right"]
Phase = Literal["setup", "running", "ended", "aborted"]
Outcome = Literal["undecided", "caught", "survived"]

ROBOTS: tuple[Robot, Robot] = ("hider", "seeker")
PRIMITIVES: tuple[Primitive, ...] = ("stay", "forward", "backward", "left", "right")

GOAL_COUNT = 121
STATE_IMAGE_SIZE = 128
MAXIMUM_STEPS = 100_000

Nanoseconds = Annotated[int, Meta(ge=0, le=2**63 - 1)]
StepNumber = Annotated[int, Meta(ge=0, le=MAXIMUM_STEPS)]
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
REASON_LIMIT = 200
"""Letters of a short text: a name, or a reason for people."""
ShortText = Annotated[str, Meta(max_length=REASON_LIMIT)]
LongText = Annotated[str, Meta(max_length=2000)]
Metres = Annotated[float, Meta(ge=-100.0, le=100.0)]
Length = Annotated[float, Meta(ge=0.0, le=100.0)]
Radians = Annotated[float, Meta(ge=-7.0, le=7.0)]
Pixels = Annotated[int, Meta(ge=1, le=4096)]
Seconds = Annotated[float, Meta(ge=0.0, le=1e9)]


def require_finite(name: str, *values: float) -> None:
    """NaN passes every range check, so it is looked for by itself."""
    for value in values:
        if not math.isfinite(value):
            raise ValueError(f"{name} must be finite, got {value}")


def _require_bytes(name: str, data: bytes, expected: int) -> None:
    if len(data) != expected:
        raise ValueError(f"{name} must hold {expected} bytes, got {len(data)}")


class Message(Struct, frozen=True, kw_only=True):
    """What every message carries."""

    stamp: Annotated[Nanoseconds, Meta(description="moment of capture, ns since the Unix epoch")]
    episode: Annotated[Count, Meta(description="episode number, 0 = outside any episode")] = 0
    step: Annotated[StepNumber, Meta(description="step of the episode, 0 = the start")] = 0


class Rules(Struct, frozen=True, kw_only=True):
    """The rules of one game; the defaults are the preset `paper` of the reading of the paper."""

    maximum_steps: Annotated[int, Meta(ge=1, le=MAXIMUM_STEPS, description="T: the hider survives when this step is reached")] = (
        100
    )
    catch_distance: Annotated[Length, Meta(description="m between centres, caught at or below")] = 0.150
    catching: Annotated[bool, Meta(description="false: catches are ignored (to record an evader's whole action sequence)")] = True
    start_distance_minimum: Annotated[Length, Meta(description="m between centres at the start")] = 0.250
    start_distance_maximum: Annotated[Length, Meta(description="m between centres at the start")] = 0.450
    layout: Annotated[ShortText, Meta(description="`lab`, `random`, or the path of a layout file")] = "random"
    step_period: Annotated[Seconds, Meta(description="s per step in real time; 0 = as fast as the players answer")] = 0.25

    def __post_init__(self) -> None:
        require_finite("rules", self.catch_distance, self.start_distance_minimum, self.start_distance_maximum, self.step_period)
        if self.start_distance_minimum > self.start_distance_maximum:
            raise ValueError("start_distance_minimum must not exceed start_distance_maximum")


class Players(Struct, frozen=True, kw_only=True):
    """Who drives the robots."""

    hider: Annotated[
        ShortText,
        Meta(description="who drives the hider: `planner`, `human` (at the console), or a row of the table of `vantage collect`"),
    ] = "planner"
    seeker: Annotated[ShortText, Meta(description="preset of the seeker: `expert` or `glancing`")] = "glancing"
    person: Annotated[
        ShortText, Meta(description="name or pseudonym of the human who drives; empty when none does, or it is not to be stored")
    ] = ""


class Episode(Message, frozen=True, kw_only=True):
    """One game: published when it is set up, starts, ends or is aborted."""

    seed: Annotated[Count, Meta(description="seed of layout, start, camera noise and exploration")]
    phase: Phase
    rules: Rules = field(default_factory=Rules)
    players: Players = field(default_factory=Players)
    outcome: Outcome = "undecided"
    caught_step: Annotated[StepNumber | None, Meta(description="step of the catch; null unless caught")] = None
    reason: Annotated[ShortText, Meta(description="why it ended or was aborted, for people")] = ""
    paused: Annotated[bool, Meta(description="the step clock of a running game stands still; said again when it goes on")] = False
    request: Annotated[ShortText, Meta(description="`Control.request` that asked for the game; empty: none did")] = ""


class Tick(Message, frozen=True, kw_only=True):
    """The step clock: `late` empty opens the step; else it closes it, and the named robots stay where they are."""

    late: Annotated[tuple[Robot, ...], Meta(max_length=2, description="robots whose command did not come in time")] = ()


class Box(Struct, frozen=True, kw_only=True):
    """An obstacle: a box standing on the arena floor."""

    x: Annotated[Metres, Meta(description="centre, m")]
    y: Annotated[Metres, Meta(description="centre, m")]
    half_width: Annotated[float, Meta(gt=0.0, le=10.0, description="half the side along the box's own x, m")]
    half_depth: Annotated[float, Meta(gt=0.0, le=10.0, description="half the side along the box's own y, m")]
    heading: Annotated[Radians, Meta(description="of the box's own x, rad")] = 0.0
    height: Annotated[Length, Meta(description="m above the floor")] = 0.20

    def __post_init__(self) -> None:
        require_finite("box", self.x, self.y, self.half_width, self.half_depth, self.heading, self.height)


class Layout(Message, frozen=True, kw_only=True):
    """The arena and what stands in it."""

    width: Annotated[float, Meta(gt=0.0, le=100.0, description="arena along x, m")] = 1.2
    depth: Annotated[float, Meta(gt=0.0, le=100.0, description="arena along y, m")] = 1.2
    obstacles: Annotated[tuple[Box, ...], Meta(max_length=64)] = ()

    def __post_init__(self) -> None:
        require_finite("layout", self.width, self.depth)


class Pose(Message, frozen=True, kw_only=True):
    """Where a robot is."""

    x: Annotated[Metres, Meta(description="m, arena frame")]
    y: Annotated[Metres, Meta(description="m, arena frame")]
    heading: Annotated[Radians, Meta(description="rad, counter-clockwise from +x")]

    def __post_init__(self) -> None:
        require_finite("pose", self.x, self.y, self.heading)


class Track(Message, frozen=True, kw_only=True):
    """Where the overhead camera sees a robot now, at the camera's own rate: for those who close a control loop on it.

    Between steps, outside games and while a robot drives to its start, too; `hider/pose` and `seeker/pose` are the one pose
    of each step. Episode and step are those being played, 0 outside a game.
    """

    x: Annotated[Metres, Meta(description="centre, m, arena frame")]
    y: Annotated[Metres, Meta(description="centre, m, arena frame")]
    heading: Annotated[Radians, Meta(description="rad, counter-clockwise from +x")]
    speed_x: Annotated[float, Meta(ge=-100.0, le=100.0, description="m/s along the arena's x")] = 0.0
    speed_y: Annotated[float, Meta(ge=-100.0, le=100.0, description="m/s along the arena's y")] = 0.0
    turn_rate: Annotated[float, Meta(ge=-1000.0, le=1000.0, description="rad/s, counter-clockwise")] = 0.0
    covariance: Annotated[
        tuple[float, float, float, float, float, float],
        Meta(description="of x, y, heading: xx, xy, xh, yy, yh, hh, in m and rad"),
    ] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    seen: Annotated[bool, Meta(description="false: predicted, the camera did not see the tag in this frame")] = True

    def __post_init__(self) -> None:
        require_finite("track", self.x, self.y, self.heading, self.speed_x, self.speed_y, self.turn_rate, *self.covariance)


class Command(Message, frozen=True, kw_only=True):
    """What a robot does in this step."""

    primitive: Primitive


class Motion(Message, frozen=True, kw_only=True):
    """How a real robot came to this step: the driver's report, by which the tracker knows when to look.

    Step 0: it stands at its start. Step n + 1: it is done with the command of step n, whatever came of it.
    """

    primitive: Annotated[Primitive, Meta(description="what it was told; `stay` at step 0")]
    result: Annotated[
        Literal["completed", "refused", "stuck", "timed-out", "stopped", "lost"],
        Meta(
            description="completed: within tolerance; refused: not begun, it would have collided; stuck: wheels turned, the "
            "robot did not; timed-out: not within tolerance in time; stopped: emergency stop; lost: no tracked pose to drive by"
        ),
    ]
    distance_error: Annotated[Length, Meta(description="m between where it was to be and where it is tracked")] = 0.0
    heading_error: Annotated[Radians, Meta(description="rad, tracked minus wanted")] = 0.0
    elapsed: Annotated[Seconds, Meta(description="s from the command to this report; differs from run to run")] = 0.0
    battery: Annotated[
        Annotated[float, Meta(ge=0.0, le=100.0)] | None, Meta(description="V; null when the robot does not say")
    ] = None
    reason: Annotated[ShortText, Meta(description="what went wrong, for people; empty when completed")] = ""

    def __post_init__(self) -> None:
        numbers = (self.distance_error, self.heading_error, self.elapsed)
        require_finite("motion", *numbers, *(() if self.battery is None else (self.battery,)))


class Intrinsics(Struct, frozen=True, kw_only=True):
    """Pinhole camera, and where it sits on the robot (looking along the robot's heading)."""

    fx: Annotated[float, Meta(gt=0.0, le=1e5, description="focal length, px")]
    fy: Annotated[float, Meta(gt=0.0, le=1e5, description="focal length, px")]
    cx: Annotated[float, Meta(ge=-1e5, le=1e5, description="principal point from the left edge, px")]
    cy: Annotated[float, Meta(ge=-1e5, le=1e5, description="principal point from the top edge, px")]
    mount_height: Annotated[Length, Meta(description="optical centre above the floor, m")] = 0.080

    def __post_init__(self) -> None:
        require_finite("intrinsics", self.fx, self.fy, self.cx, self.cy, self.mount_height)


class DepthImage(Message, frozen=True, kw_only=True):
    """First-person depth along the optical axis."""

    width: Pixels
    height: Pixels
    intrinsics: Intrinsics
    data: Annotated[bytes, Meta(description="uint16 [height, width], mm along the optical axis, 0 = no return")]

    def __post_init__(self) -> None:
        _require_bytes("depth image", self.data, 2 * self.width * self.height)


class ColorImage(Message, frozen=True, kw_only=True):
    """Colour picture, registered to the depth image of the same step."""

    width: Pixels
    height: Pixels
    intrinsics: Intrinsics
    data: Annotated[bytes, Meta(description="uint8 [height, width, 3], red green blue")]

    def __post_init__(self) -> None:
        _require_bytes("color image", self.data, 3 * self.width * self.height)


class StateImage(Message, frozen=True, kw_only=True):
    """The state image I: top-down visibility map of one robot's current view (paper, State Representation)."""

    data: Annotated[bytes, Meta(description="uint8 [128, 128], palette index; row 0 is the far side (y = arena depth)")]
    other_x: Annotated[Metres | None, Meta(description="other robot's centre as seen, m; null when not seen")] = None
    other_y: Annotated[Metres | None, Meta(description="other robot's centre as seen, m; null when not seen")] = None

    def __post_init__(self) -> None:
        _require_bytes("state image", self.data, STATE_IMAGE_SIZE * STATE_IMAGE_SIZE)
        require_finite("state image", *(v for v in (self.other_x, self.other_y) if v is not None))


class Plan(Message, frozen=True, kw_only=True):
    """What the hider intends from this step on, and the value map it chose from (paper, Inference and Planning)."""

    horizon: Annotated[StepNumber, Meta(description="T, steps")]
    checkpoint_interval: Annotated[int, Meta(ge=1, le=MAXIMUM_STEPS, description="N, steps")] = 10
    values: Annotated[
        tuple[Annotated[float, Meta(ge=0.0, le=1e6)] | None, ...],
        Meta(
            max_length=GOAL_COUNT,
            description="V per goal, lower is safer, null = blocked; goal = 11 row + column, x = 0.1 (column + 1), "
            "y = 0.1 (row + 1); empty when the policy has none",
        ),
    ] = ()
    goal: Annotated[Annotated[int, Meta(ge=0, lt=GOAL_COUNT)] | None, Meta(description="index of the chosen goal")] = None
    path: Annotated[
        bytes, Meta(description="float32 [n, 3], planned x, y (m), heading (rad) at this step and each later one")
    ] = b""
    elapsed: Annotated[Seconds, Meta(description="time taken to plan, s; differs from run to run, like a stamp")] = 0.0

    def __post_init__(self) -> None:
        if self.values and len(self.values) != GOAL_COUNT:
            raise ValueError(f"values must be empty or hold {GOAL_COUNT}, got {len(self.values)}")
        require_finite("plan", self.elapsed, *(v for v in self.values if v is not None))
        if len(self.path) % 12 or len(self.path) > 12 * (MAXIMUM_STEPS + 1):
            raise ValueError(f"path must hold n x 3 float32, got {len(self.path)} bytes")


class PredictRequest(Message, frozen=True, kw_only=True):
    """Ask VPT-TOB and VPN: along each path, is the hider caught at each horizon?"""

    state_image: Annotated[bytes, Meta(description="uint8 [128, 128], palette index: the hider's view at step 0")]
    path_count: Annotated[int, Meta(ge=1, le=4096)]
    path_steps: Annotated[int, Meta(ge=1, le=4096, description="positions per path: steps 0 .. path_steps - 1")]
    paths: Annotated[bytes, Meta(description="float32 [path_count, path_steps, 2], planned x, y, m")]
    horizons: Annotated[tuple[StepNumber, ...], Meta(min_length=1, max_length=1024, description="steps; each below path_steps")]
    views: Annotated[
        tuple[tuple[Count, Count], ...],
        Meta(max_length=256, description="(path, index into horizons) pairs whose predicted view is wanted"),
    ] = ()

    def __post_init__(self) -> None:
        _require_bytes("state image", self.state_image, STATE_IMAGE_SIZE * STATE_IMAGE_SIZE)
        _require_bytes("paths", self.paths, 8 * self.path_count * self.path_steps)
        if max(self.horizons) >= self.path_steps:
            raise ValueError(f"horizon {max(self.horizons)} lies beyond the {self.path_steps} positions of a path")
        for path, horizon in self.views:
            if path >= self.path_count or horizon >= len(self.horizons):
                raise ValueError(f"view ({path}, {horizon}) lies outside the request")


class PredictReply(Message, frozen=True, kw_only=True):
    """The answer to a PredictRequest."""

    caught: Annotated[
        bytes, Meta(description="float32 [path_count, len(horizons)], probability that the hider is caught by then")
    ]
    views: Annotated[
        tuple[bytes, ...],
        Meta(max_length=256, description="uint8 [128, 128, 3] each: predicted seeker views, red green blue, as asked"),
    ] = ()
    weights: Annotated[ShortText, Meta(description="hash of the weights that answered")] = ""
    distinct: Annotated[Count, Meta(description="distinct (path prefix, horizon) queries computed")] = 0
    elapsed: Annotated[Seconds, Meta(description="time taken, s; differs from run to run, like a stamp")] = 0.0

    def __post_init__(self) -> None:
        require_finite("reply", self.elapsed)
        if len(self.caught) % 4:
            raise ValueError(f"caught must hold float32, got {len(self.caught)} bytes")
        if not all(0.0 <= chance <= 1.0 for (chance,) in struct.iter_unpack("<f", self.caught)):  # NaN is not, either
            raise ValueError("caught must hold probabilities in 0..1")
        for view in self.views:
            _require_bytes("view", view, 3 * STATE_IMAGE_SIZE * STATE_IMAGE_SIZE)
