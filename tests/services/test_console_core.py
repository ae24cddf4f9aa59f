"""The console's core: what pages are shown, the services' health, recording, and its own health."""

from __future__ import annotations

import json
import random
import re
from typing import Any

import pytest
from msgspec.structs import replace

from schemas import (
    GOAL_COUNT,
    ROBOTS,
    TOPICS,
    Control,
    Gap,
    InputHealth,
    MalformedMessage,
    Pose,
    Rules,
    Track,
    decode,
)
from services.console import requests
from services.console.application import FOLDER
from services.console.core import ConsoleCore
from services.console.events import PAGE, PageEvent, Refusals
from services.console.prediction import HORIZONS
from services.console.reports import SILENCE
from services.seeker.policy import PRESETS
from tests.services.console_game import STEPS, Table, health, parse, play
from tests.stack.absurd import shaped
from vantage.perception.palette import OTHER, OWN, PALETTE
from vantage.service import SECOND, Arrived, Captured, Write


def test_a_page_is_shown_everything_that_is_said(table: Table) -> None:
    play(table)
    seen = table.pages.seen[1]
    assert seen[0][0]["key"] == "welcome"
    for key in ("layout", "hider/pose", "seeker/pose", "hider/color", "seeker/depth", "hider/view", "seeker/view", "tick"):
        said = table.of(key)
        shown = table.frames(key)
        assert [header["stamp"] for header, _ in shown] == [str(message.stamp) for message in said], key
        for (header, payload), message in zip(shown, said, strict=True):
            assert (header["episode"], header["step"]) == (message.episode, message.step)
            assert payload == getattr(message, "data", b"")
    phases = [header["phase"] for header, _ in table.frames("episode")]
    assert phases == ["setup", "running", "ended"]
    episode = table.header("episode")
    assert episode["rules"]["maximum_steps"] == STEPS
    assert episode["players"] == {"hider": "planner", "seeker": "glancing"}
    assert (episode["outcome"], episode["reason"]) == (table.of("episode")[-1].outcome, table.of("episode")[-1].reason)
    pose, shown_pose = table.of("hider/pose")[-1], table.header("hider/pose")
    assert (shown_pose["x"], shown_pose["y"], shown_pose["heading"]) == (pose.x, pose.y, pose.heading)
    color = table.header("hider/color")
    assert (color["width"], color["height"], color["intrinsics"]["fx"]) == (
        table.of("hider/color")[-1].width,
        table.of("hider/color")[-1].height,
        table.of("hider/color")[-1].intrinsics.fx,
    )
    assert table.header("layout")["obstacles"][0]["half_width"] == table.of("layout")[-1].obstacles[0].half_width


def test_the_plan_is_shown_with_its_path_and_that_goals_can_be_asked_for(table: Table) -> None:
    play(table)
    plan = table.of("hider/plan")[-1]
    header, payload = table.frames("hider/plan")[-1]
    assert header["unpredictable"] == ""
    assert header["values"] == list(plan.values)
    assert (header["goal"], header["horizon"], header["checkpoint_interval"]) == (plan.goal, plan.horizon, 10)
    assert payload == plan.path


def test_payloads_begin_where_arrays_may_begin(table: Table) -> None:
    written: list[bytes] = []
    table.pages.write = lambda data: written.append(data)  # type: ignore[method-assign]
    play(table, steps=3)
    assert len(written) > 20
    for data in written:
        assert (4 + int.from_bytes(data[4:8], "little")) % 8 == 0


def test_the_welcome_says_what_a_page_needs_to_draw(table: Table) -> None:
    welcome = table.header("welcome")
    assert (welcome["client"], welcome["arena"], welcome["deployment"]) == (1, "table", "simulation")
    assert welcome["size"] == 1.2
    # What forms offer is what the server takes; and no more is said than the page reads.
    for seeker in welcome["seekers"]:
        for layout in welcome["layouts"]:
            requests.decode_request(json.dumps({"type": "start", "seeker": seeker, "layout": layout}))
    assert (len(welcome["seekers"]), len(welcome["layouts"]), welcome["horizons"]) == (2, 2, HORIZONS)
    assert welcome["goals"][1][0] - welcome["goals"][0][0] == pytest.approx(welcome["goal_spacing"])
    limits = welcome["limits"]
    assert set(limits) == {"steps", "games", "person", "period"}
    for name in ("steps", "games"):
        requests.decode_request(json.dumps({"type": "start", name: limits[name]}))
        with pytest.raises(requests.MalformedRequest):
            requests.decode_request(json.dumps({"type": "start", name: limits[name] + 1}))
    assert set(welcome["seekers"]) == set(PRESETS)
    page = "".join(path.read_text() for path in FOLDER.rglob("*.js"))
    assert not [name for name in (*welcome, *limits) if not re.search(rf"\b{name}\b", page)]
    assert len(welcome["goals"]) == GOAL_COUNT
    assert welcome["palette_names"][OWN:] == ["hider", "seeker"]
    for robot, colors in welcome["palettes"].items():
        other = "seeker" if robot == "hider" else "hider"
        assert colors[:OWN] == PALETTE[:OWN].tolist()
        assert (colors[OWN], colors[OTHER]) == (welcome["robot_colors"][robot], welcome["robot_colors"][other]), "whoever looks"
    assert welcome["field_of_view"] == pytest.approx(1.501, abs=1e-3)


def test_who_comes_late_sees_the_present_at_once_and_welcome_first(table: Table) -> None:
    play(table)
    late = table.come(7)
    table.settle()
    seen = table.pages.seen[late]
    assert [header["key"] for header, _ in seen[:2]] == ["welcome", "episode"]
    keys = [header["key"] for header, _ in seen]
    assert len(keys) == len(set(keys))
    expected = {header["key"]: (header, payload) for header, payload in table.pages.seen[1] if header["key"] != "notice"}
    assert set(keys) == set(expected) | {"recording", "services", "score", "session", "driven"}
    driven = table.header("driven", late)
    for robot in ROBOTS:
        poses = table.of(f"{robot}/pose")
        assert driven[robot] == [[pose.step, round(pose.x, 4), round(pose.y, 4)] for pose in poses]
    for header, payload in seen:
        if "stamp" in header:
            assert (header, payload) == expected[header["key"]]


def test_nothing_is_encoded_while_no_page_is_there(table: Table) -> None:
    table.go()
    table.settle()
    written: list[bytes] = []
    table.pages.write = lambda data: written.append(data)  # type: ignore[method-assign]
    table.network.session("command-line").publish(
        "control", Control(stamp=table.now, action="start", rules=Rules(maximum_steps=3))
    )
    table.run(lambda: any(message.phase == "ended" for message in table.of("episode")))
    assert not written


def test_the_next_game_puts_the_last_one_away(table: Table) -> None:
    play(table)
    first = table.of("episode")[-1].episode
    table.ask(requests.Start(steps=50, seed=9))
    table.run(lambda: table.of("episode")[-1].episode != first)
    table.settle()
    table.come(3)
    table.settle()
    assert {header["episode"] for header, _ in table.pages.seen[3] if header.get("episode")} == {first + 1}


def test_a_track_outside_games_is_shown(table: Table) -> None:
    table.say("tracker", [("hider/track", Track(stamp=table.now, x=0.5, y=0.4, heading=0.1, seen=False))])
    assert table.header("hider/track") | {"stamp": ""} == {
        "key": "hider/track",
        "stamp": "",
        "episode": 0,
        "step": 0,
        "x": 0.5,
        "y": 0.4,
        "heading": 0.1,
        "seen": False,
    }


# Services and recording


def rows(table: Table) -> dict[str, dict[str, Any]]:
    return {row["service"]: row for row in table.header("services")["services"]}


def test_a_service_is_silent_after_two_and_a_half_seconds(table: Table) -> None:
    lossy = health("tracker", table.now, "degraded", "the overhead camera is dark")
    counts = (InputHealth(key="episode", lost=2, malformed=1), InputHealth(key="tick", lost=3))
    table.say("tracker", [("health/tracker", replace(lossy, inputs=counts, unexpected=4, failed=2))])
    heard = table.now
    table.run_for(1.0)
    row = rows(table)["tracker"]
    assert (row["state"], row["reason"]) == ("degraded", "the overhead camera is dark")
    assert (row["lost"], row["bad"], row["uptime"]) == (5, 7, 5.0), "all that `vantage status` counts"
    table.run_for(3.0)
    row = rows(table)["tracker"]
    assert row["state"] == "silent"
    assert row["age"] > SILENCE / SECOND
    assert "said nothing for" in row["reason"]
    states = [
        ({entry["service"]: entry for entry in header["services"]}.get("tracker"), table.now)
        for header, _ in table.frames("services")
    ]
    for entry, _ in states:
        if entry is not None:
            assert (entry["state"] == "silent") == (entry["age"] > SILENCE / SECOND)
    assert heard < table.now


def test_recording_is_on_in_trouble_or_off(table: Table) -> None:
    table.run_for(1.0)
    assert table.header("recording")["state"] == "off"
    for state, reason, shown in (("ok", "", "on"), ("degraded", "the disk is full", "trouble"), ("stopping", "", "off")):
        table.observer.publish("health/recorder", health("recorder", table.now, state, reason))
        table.run_for(1.0)
        assert table.header("recording")["state"] == shown
        assert reason in table.header("recording")["reason"]
    table.observer.publish("health/recorder", health("recorder", table.now))
    table.run_for(4.0)
    assert table.header("recording")["state"] == "trouble"
    assert table.header("recording")["reason"].startswith("nothing heard of the recorder for ")


def test_gaps_are_counted(table: Table) -> None:
    for missed in (3, 4):
        table.observer.publish("gap", Gap(stamp=table.now, key="tick", publisher="referee", missed=missed))
    table.settle()
    assert table.header("recording")["lost"] == 7


# Health


def test_health_tells_of_a_missing_server_and_of_refusals_for_ten_seconds(table: Table) -> None:
    core = table.core
    assert core.trouble == ""
    core.step(Captured(PAGE, None, table.now, "port 8600 is taken"), table.now)
    assert core.trouble == "port 8600 is taken"
    core.step(Captured(PAGE, None, table.now), table.now)
    assert core.trouble == ""
    table.bus.post(Captured(PAGE, Refusals({"wrong origin": 3}), table.now))
    # A browser's own question for a file that no page names, a laptop that sleeps, a wish that was answered: no trouble.
    harmless = {"no such file": 7, "gone silent": 2, "malformed request": 1, "no token": 4, "wrong token": 9}
    table.bus.post(Captured(PAGE, Refusals({"wrong origin": 5, "too fast": 1, **harmless}), table.now))
    table.settle()
    assert core.trouble == "6 requests refused in the last 10 s (wrong origin 5, too fast 1)"
    assert table.console.health_report("ok").state == "degraded"
    table.run_for(12.0)
    assert core.trouble == ""


def test_when_the_server_goes_its_pages_are_gone(table: Table) -> None:
    table.bus.post(Captured(PAGE, None, table.now, "it died"))
    table.settle()
    seen = len(table.pages.seen[1])
    table.run_for(3.0)
    assert len(table.pages.seen[1]) == seen


@pytest.mark.parametrize("seed", range(3))
def test_absurd_messages_break_nothing(table: Table, seed: int) -> None:
    source = random.Random(seed)
    core = table.core
    taken: set[str] = set()
    for _ in range(40):
        for key in core.declaration.inputs:
            try:
                message = decode(TOPICS[key].type, shaped(TOPICS[key].type, source))
            except MalformedMessage:
                continue
            taken.add(key)
            for send in core.step(Arrived(key, message), table.now):
                if isinstance(send, Write):
                    parse(send.data[4:])
    assert len(taken) > len(core.declaration.inputs) // 2
    late = ConsoleCore({})
    late.step(Arrived("hider/pose", Pose(stamp=1, x=0.1, y=0.1, heading=0.0)), 1)
    assert len(late.step(Captured(PAGE, PageEvent(1), 1), 1)) == 7  # welcome, pose, and what the console itself knows
