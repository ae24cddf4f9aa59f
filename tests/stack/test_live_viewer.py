"""`vantage foxglove` on a real deployment: it shows what happens, disturbs nobody, and ends by Ctrl-C."""

from __future__ import annotations

import json
import re
import signal
import struct
import subprocess
import time

import pytest

from tests.stack.table import PATIENCE, VANTAGE, Table, follow, stop_games, wish
from vantage.bus.zenoh_bus import ZenohBus
from vantage.match import Match
from vantage.watch import HealthWatch

client = pytest.importorskip("websockets.sync.client")


def test_a_game_is_seen_live(table: Table) -> None:
    assert table.started.returncode == 0, table.started.stderr
    words = [VANTAGE, "foxglove", "--folder", table.folder, "--port", "0"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=table.home)
    try:
        assert process.stdout is not None
        found = re.search(r"ws://127\.0\.0\.1:(\d+)", process.stdout.readline())
        assert found
        # Games without end: the viewer's links to the services come up one after another.
        with ZenohBus("command-line", table.folder) as bus:
            match = Match(bus, wish(seed=7, games=1000, steps=50, period=0.1))
            follow(match, lambda: match.step >= 2, "a game runs")
        watch_until_all_was_seen(int(found[1]))
        stop_games(table.folder)
        play = table.command("play", "--seed", "7", "--steps", "8", "--period", "0")
        assert play.returncode == 0, play.stdout + play.stderr
        with HealthWatch(table.deployment) as watch:
            table.wait_until_healthy(watch)
        process.send_signal(signal.SIGINT)
        said, complained = process.communicate(timeout=PATIENCE)
        assert (process.returncode, complained) == (0, "")
        assert said.splitlines()[-1].startswith("closed")  # on a busy machine also how many messages came too fast
        assert json.loads((table.folder / "foxglove.layout.json").read_text())["configById"]
    finally:
        process.kill()
        process.wait()


def watch_until_all_was_seen(port: int) -> None:
    """Subscribe to everything until both robots' poses, pictures and views, the scene and the value map were seen."""
    seen: set[str] = set()
    topics: dict[int, str] = {}
    wanted = {"viewer/scene", "viewer/hider/plan/picture", "viewer/text", "viewer/hider/view", "viewer/seeker/view"}
    wanted |= {f"viewer/{robot}/{part}" for robot in ("hider", "seeker") for part in ("pose", "color")}
    deadline = time.monotonic() + PATIENCE
    with client.connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None, close_timeout=0.5) as socket:
        while not wanted <= seen:
            assert time.monotonic() < deadline, sorted(wanted - seen)
            try:
                data = socket.recv(timeout=0.2)
            except TimeoutError:
                continue
            if isinstance(data, bytes):
                opcode, subscription, _ = struct.unpack_from("<BIQ", data)
                if opcode == 1:
                    seen.add(topics[subscription])
                continue
            said = json.loads(data)
            if said["op"] == "advertise":
                new = {channel["id"]: channel["topic"] for channel in said["channels"]}
                topics |= new
                socket.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": id, "channelId": id} for id in new]}))
