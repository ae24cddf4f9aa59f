"""The topic table: everything that may be said on the bus, by whom, and how it is delivered.

Keys stand below `vantage/{arena}/` on the bus; everywhere in the code the short key (`hider/pose`) is used.
Publishing a key that is not in the table is an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from schemas import messages as m
from schemas import operation as o

Delivery = Literal["lossless", "latest"]

WORLD = ("simulator", "tracker")
HIDER = ("planner", "console", "hider")
"""Who may drive the hider: `Episode.players.hider` says who does in a game, the others are silent."""
DRIVERS = ("robot", "onboard")
"""Who carries commands out on a real table: our driver, or a robot that speaks on the bus itself."""
COMMAND_LINE = ("command-line", "command-line-stop")
"""Who asks for games at a terminal, and who stops them beside it: a name is on the bus once."""
CAMERAS = ("rehearsal",)
"""Who publishes raw camera frames; the tracker opens real cameras itself."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the topic table.

    Attributes:
        key: short key.
        type: message type.
        publishers: services that may publish it; in one deployment exactly one of them does (the seeker's and the
            hider's commands and views have one publisher each).
        delivery: `lossless` (cached, gaps noticed and recovered) or `latest` (a slow reader skips).
        rate: expected messages per second in a real-time game, 0 = on occasion.
        recorded: whether the recorder writes it.
        cache: lossless only: how many messages the publisher keeps for recovery and late joiners.
        history: how many past messages a late joiner gets (latched topics: 1).
    """

    key: str
    type: type[m.Message]
    publishers: tuple[str, ...]
    delivery: Delivery = "lossless"
    rate: float = 0.0
    recorded: bool = True
    cache: int = 256
    history: int = 1


@dataclass(frozen=True, slots=True)
class Call:
    """One row of the call table: a question with an answer. Request and reply are logged as the topics named."""

    key: str
    request: type[m.Message]
    reply: type[m.Message]
    server: str


SERVICES = (
    *("simulator", "tracker", "robot", "onboard", "rehearsal"),
    *("referee", "seeker", "planner", "predictor", "recorder", "console", "hider"),
)

_STEP_RATE = 4.0

TOPICS: dict[str, Topic] = {
    topic.key: topic
    for topic in (
        Topic("episode", m.Episode, ("referee",)),
        Topic("tick", m.Tick, ("referee",), rate=_STEP_RATE),
        Topic("layout", m.Layout, WORLD),
        *(Topic(f"{robot}/pose", m.Pose, WORLD, rate=_STEP_RATE) for robot in m.ROBOTS),
        *(Topic(f"{robot}/depth", m.DepthImage, WORLD, rate=_STEP_RATE, cache=64) for robot in m.ROBOTS),
        *(Topic(f"{robot}/color", m.ColorImage, WORLD, rate=_STEP_RATE, cache=64) for robot in m.ROBOTS),
        Topic("hider/command", m.Command, HIDER, rate=_STEP_RATE),
        Topic("seeker/command", m.Command, ("seeker",), rate=_STEP_RATE),
        Topic("hider/view", m.StateImage, HIDER, rate=_STEP_RATE),
        Topic("seeker/view", m.StateImage, ("seeker",), rate=_STEP_RATE),
        *(Topic(f"{robot}/motion", m.Motion, DRIVERS, rate=_STEP_RATE) for robot in m.ROBOTS),
        *(Topic(f"{robot}/track", m.Track, ("tracker",), "latest", rate=30.0) for robot in m.ROBOTS),
        Topic("overhead/color", m.ColorImage, CAMERAS, "latest", rate=15.0, recorded=False),
        *(Topic(f"{robot}/camera/depth", m.DepthImage, CAMERAS, "latest", rate=5.0, recorded=False) for robot in m.ROBOTS),
        *(Topic(f"{robot}/camera/color", m.ColorImage, CAMERAS, "latest", rate=5.0, recorded=False) for robot in m.ROBOTS),
        Topic("hider/plan", m.Plan, HIDER),
        Topic("predictor/request", m.PredictRequest, ("predictor", "replay"), cache=16, history=0),
        Topic("predictor/reply", m.PredictReply, ("predictor", "replay"), cache=16, history=0),
        Topic("control", o.Control, ("console", *COMMAND_LINE, "referee"), history=0),
        Topic("playback", o.Playback, ("replay",), rate=2.0, recorded=False),
        Topic("gap", o.Gap, ("recorder",), history=0),
        *(Topic(f"health/{service}", o.Health, (service,), rate=1.0, cache=16) for service in SERVICES),
    )
}

CALLS: dict[str, Call] = {call.key: call for call in (Call("predictor", m.PredictRequest, m.PredictReply, server="predictor"),)}
