"""The live Foxglove server, asked by a WebSocket client that speaks Foxglove's protocol."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import time
from collections.abc import Iterator
from typing import Any

import pytest
from mcap_protobuf.decoder import DecoderFactory
from msgspec.structs import replace

from schemas import GOAL_COUNT, ColorImage, Episode, Intrinsics, Layout, Plan, Pose
from vantage.bus import InProcessNetwork, Sample
from vantage.live_viewer import BACKLOG, LiveViewerError, Server, Subscribed

client = pytest.importorskip("websockets.sync.client")
LENS = Intrinsics(fx=300.0, fy=300.0, cx=319.5, cy=239.5)
DEADLINE = 120.0


class Table:
    """A bus with a simulator and a referee on it, and the server listening; `pump` lets it take what came."""

    def __init__(self) -> None:
        network = self.network = InProcessNetwork()
        self.simulator, self.referee = network.session("simulator"), network.session("referee")
        self.bus = network.session("foxglove-1")
        self.server = Server("127.0.0.1", 0, self.bus.post)
        self.bus.subscribe("**", raw=True)

    def pump(self) -> None:
        while (event := self.bus.receive(0.0)) is not None:
            if isinstance(event, Sample):
                self.server.take(event)
            elif isinstance(event, Subscribed):
                self.server.send_last(event)


@pytest.fixture
def table() -> Iterator[Table]:
    made = Table()
    yield made
    made.server.stop()
    made.bus.close()


class Foxglove:
    """A viewer: knows the channels, subscribes, decodes what comes with the schemas that were announced."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self._open = contextlib.ExitStack()
        address = f"ws://127.0.0.1:{table.server.port}"
        self._socket = self._open.enter_context(
            client.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None, close_timeout=0.5)
        )
        self.channels: dict[str, dict[str, Any]] = {}
        self.got: list[tuple[str, Any]] = []
        self._topics: dict[int, str] = {}
        self._decoders: dict[int, Any] = {}

    def close(self) -> None:
        self._open.close()

    def subscribe(self, *topics: str) -> None:
        self.until(lambda: set(topics) <= self.channels.keys())
        wanted = []
        for topic in topics:
            channel = self.channels[topic]
            self._topics[channel["id"]] = topic
            wanted.append({"id": channel["id"], "channelId": channel["id"]})
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def until(self, holds: Any) -> None:
        deadline = time.monotonic() + DEADLINE
        while not holds():
            assert time.monotonic() < deadline, (sorted(self.channels), [topic for topic, _ in self.got])
            self._table.pump()
            with contextlib.suppress(TimeoutError):
                self._take(self._socket.recv(timeout=0.02))

    def of(self, topic: str) -> list[Any]:
        return [message for name, message in self.got if name == topic]

    def _take(self, data: str | bytes) -> None:
        if isinstance(data, str):
            said = json.loads(data)
            if said["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in said["channels"]}
            return
        opcode, subscription, _ = struct.unpack_from("<BIQ", data)
        if opcode != 1:
            return
        topic = self._topics[subscription]
        channel = self.channels[topic]
        decode = self._decoders.get(subscription)
        if decode is None:
            from base64 import b64decode

            from mcap.records import Schema

            schema = Schema(1, b64decode(channel["schema"]), channel["schemaEncoding"], channel["schemaName"])
            decode = self._decoders[subscription] = DecoderFactory().decoder_for("protobuf", schema)
        self.got.append((topic, decode(data[13:])))


def pose(step: int) -> Pose:
    return Pose(stamp=1_700_000_000_000_000_000 + step, episode=1, step=step, x=0.01 * step, y=0.5, heading=0.0)


def test_a_viewer_sees_what_is_said_and_what_was_said_last(table: Table) -> None:
    table.simulator.publish("layout", Layout(stamp=1, episode=1))
    table.simulator.publish("hider/pose", pose(0))
    table.referee.publish("episode", Episode(stamp=1, episode=1, seed=3, phase="running"))
    table.pump()
    viewer = Foxglove(table)
    viewer.subscribe("viewer/scene", "viewer/hider/pose", "viewer/text")
    # Said before it came: it would wait for the next game to see the scene.
    viewer.until(lambda: {topic for topic, _ in viewer.got} == {"viewer/scene", "viewer/hider/pose", "viewer/text"})
    assert {entity.id for entity in viewer.of("viewer/scene")[0].entities} == {"layout", "hider", "seeker"}
    assert "episode 1 (seed 3) running" in viewer.of("viewer/text")[0].message
    for step in range(1, 6):
        table.simulator.publish("hider/pose", pose(step))
    viewer.until(lambda: len(viewer.of("viewer/hider/pose")) == 6)
    assert [found.pose.position.x for found in viewer.of("viewer/hider/pose")] == pytest.approx(
        [0.01 * step for step in range(6)]
    )
    viewer.close()


def test_a_topic_that_is_first_said_later_is_announced(table: Table) -> None:
    viewer = Foxglove(table)
    table.pump()
    table.simulator.publish("seeker/pose", pose(4))
    viewer.subscribe("viewer/seeker/pose")
    viewer.until(lambda: len(viewer.of("viewer/seeker/pose")) == 1)
    viewer.close()


def test_a_viewer_that_stands_still_costs_nothing(table: Table) -> None:
    """Its queue is bounded; the server goes on taking messages, and others go on seeing them."""
    picture = ColorImage(stamp=1, episode=1, width=640, height=480, intrinsics=LENS, data=bytes(640 * 480 * 3))
    table.simulator.publish("hider/color", picture)
    table.simulator.publish("hider/pose", pose(0))
    table.pump()
    still, other = Foxglove(table), Foxglove(table)
    still.subscribe("viewer/hider/color")
    still.until(lambda: len(still.got) == 1)
    other.subscribe("viewer/hider/pose")
    other.until(lambda: len(other.got) == 1)
    for _ in range(2 * BACKLOG):  # it would wait for ever if it waited for the viewer
        table.simulator.publish("hider/color", picture)
        table.pump()
    table.simulator.publish("hider/pose", pose(1))
    other.until(lambda: len(other.got) == 2)
    still.close()
    other.close()


def test_what_nobody_looks_at_is_not_translated(table: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    table.simulator.publish("hider/pose", pose(0))
    table.pump()
    viewer = Foxglove(table)
    viewer.until(lambda: "viewer/hider/pose" in viewer.channels)
    translated: list[str] = []
    original = table.server._viewer.translate
    monkeypatch.setattr(table.server._viewer, "translate", lambda key, payload: translated.append(key) or original(key, payload))
    table.simulator.publish("hider/pose", pose(1))
    table.pump()
    assert translated == []
    viewer.subscribe("viewer/hider/pose")
    viewer.until(lambda: len(viewer.got) == 1)
    assert viewer.of("viewer/hider/pose")[0].pose.position.x == pytest.approx(0.01)  # the last, not the first
    table.simulator.publish("hider/pose", pose(2))
    viewer.until(lambda: len(viewer.got) == 2)
    assert translated == ["hider/pose"]
    viewer.close()


def test_a_value_map_is_announced_also_after_a_plan_without_one(table: Table) -> None:
    """Nobody looks at the first plan's path, and the next one's values must not be passed over for it."""
    planner = table.network.session("planner")
    plan = Plan(stamp=1, episode=1, horizon=1, path=bytes(24))
    planner.publish("hider/plan", plan)
    table.pump()
    planner.publish("hider/plan", replace(plan, stamp=2, values=(0.5,) * GOAL_COUNT, goal=3))
    table.pump()
    viewer = Foxglove(table)
    viewer.subscribe("viewer/hider/plan/values", "viewer/hider/plan/picture")
    viewer.until(lambda: len({topic for topic, _ in viewer.got}) == 2)
    viewer.close()


def test_a_taken_port_is_said_in_a_line() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(LiveViewerError, match="choose another --port"):
            Server("127.0.0.1", taken.getsockname()[1], lambda _: None)
