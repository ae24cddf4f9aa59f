"""The console's core: every frame, score, silence, recording, predictions, past views, replays, and what pages may cause."""

from __future__ import annotations

import json
import random
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from schemas import (
    GOAL_COUNT,
    ROBOTS,
    TOPICS,
    Control,
    Episode,
    Gap,
    InputHealth,
    MalformedMessage,
    Playback,
    Pose,
    PredictReply,
    PredictRequest,
    Rules,
    StateImage,
    Track,
    decode,
)
from services.console import requests
from services.console.core import CONTROLS_BURST, ConsoleCore
from services.console.events import PAGE, PageEvent, Refusals
from services.console.past import PastViews
from services.console.prediction import HORIZONS, chosen_horizons
from services.console.reports import SILENCE
from services.console.score import Score
from services.planner.core import PlannerCore
from services.predictor.core import PredictorCore
from services.seeker.policy import PRESETS
from tests.services.console_game import Table, health, parse
from tests.stack.absurd import shaped
from vantage.perception.palette import PALETTE
from vantage.service import SECOND, Arrived, Captured, Core, Write

STEPS = 12


@pytest.fixture(scope="module")
def networks() -> Any:
    import torch

    from vantage.networks.inference import Inference
    from vantage.networks.vpn import Vpn, VpnSettings
    from vantage.networks.vpt_tob import VptTob, VptTobSettings

    torch.manual_seed(0)
    return Inference(VptTob(VptTobSettings(width=0.25)), Vpn(VpnSettings(width=4)), batch=32, threads=1)


@pytest.fixture
def table(networks: Any) -> Table:
    """A table on which the planner plays, with a page open."""
    others: dict[str, Core] = {"planner": PlannerCore(), "predictor": PredictorCore(networks)}
    table = Table(others)
    table.come()
    table.run_for(1.0)
    return table


def play(table: Table, steps: int = STEPS, **more: Any) -> None:
    table.ask(requests.Start(steps=steps, seed=5, **more))
    before = len(table.of("episode"))
    table.run(lambda: any(message.phase in ("ended", "aborted") for message in table.of("episode")[before:]))


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
    assert header["predictable"] is True
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
    table.say("tracker", [("health/tracker", replace(lossy, inputs=counts))])
    heard = table.now
    table.run_for(1.0)
    row = rows(table)["tracker"]
    assert (row["state"], row["reason"]) == ("degraded", "the overhead camera is dark")
    assert (row["lost"], row["malformed"], row["uptime"]) == (5, 1, 5.0)
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
    assert table.header("recording") | {"lost": 0} == {
        "key": "recording",
        "state": "off",
        "lost": 0,
        "reason": "the recorder has gone silent",
    }


def test_gaps_are_counted(table: Table) -> None:
    for missed in (3, 4):
        table.observer.publish("gap", Gap(stamp=table.now, key="tick", publisher="referee", missed=missed))
    table.settle()
    assert table.header("recording")["lost"] == 7


# Score


def ended(number: int, outcome: str = "survived", step: int = 10, phase: str = "ended") -> Episode:
    return Episode(stamp=1, episode=number, step=step, seed=number, phase=phase, outcome=outcome)  # type: ignore[arg-type]


def score_of(score: Score) -> dict[str, Any]:
    header, _ = parse(score.frame())
    del header["key"]
    return header


def test_the_score_counts_each_game_once_and_as_it_stands_now() -> None:
    score = Score()
    assert score_of(score)["mean_steps"] is None
    for number, (outcome, step) in enumerate((("survived", 100), ("caught", 40), ("caught", 20)), start=1):
        score.add(ended(number, outcome, step))
        score.add(ended(number, outcome, step))
    score.add(ended(4, "undecided", 7, "aborted"))
    counts = {"games": 4, "survived": 1, "caught": 2, "aborted": 1, "discarded": 0}
    assert score_of(score) == {**counts, "mean_steps": pytest.approx(160 / 3)}
    score.discard(2)
    score.discard(2)
    assert score_of(score) == {**counts, "caught": 1, "discarded": 1, "mean_steps": pytest.approx(60)}


def test_a_running_game_that_is_discarded_is_not_aborted_besides() -> None:
    score = Score()
    score.discard(1)
    score.add(ended(1, "undecided", 3, "aborted"))
    assert score_of(score) | {"mean_steps": None} == {
        "games": 1,
        "survived": 0,
        "caught": 0,
        "aborted": 0,
        "discarded": 1,
        "mean_steps": None,
    }


def test_a_referee_that_counts_anew_is_counted_on() -> None:
    score = Score()
    for _ in range(3):
        score.begin(1)
        score.add(ended(1))
    assert score_of(score)["survived"] == 3


def test_the_score_does_not_grow() -> None:
    score = Score()
    for number in range(1, 3000):
        score.add(ended(number))
    assert score_of(score)["survived"] == 2999
    assert len(score._games) <= 1000
    assert len(score._steps) <= 1000


def test_a_game_goes_into_the_score_and_can_be_taken_back(table: Table) -> None:
    play(table)
    outcome = table.of("episode")[-1].outcome
    assert table.header("score")[outcome] == 1
    table.ask(requests.Discard(episode=table.of("episode")[-1].episode))
    table.settle()
    assert table.of("control")[-1].action == "discard"
    assert table.header("score") | {"mean_steps": None} == {
        "key": "score",
        "games": 1,
        "survived": 0,
        "caught": 0,
        "aborted": 0,
        "discarded": 1,
        "mean_steps": None,
    }
    table.ask(requests.Discard(episode=table.of("episode")[-1].episode))
    table.ask(requests.Discard(episode=77))
    table.settle()
    assert sum(control.action == "discard" for control in table.of("control")) == 1
    assert len([text for text in table.notices() if "taken back" in text]) == 2


# Predictions


def open_goals(table: Table) -> list[int]:
    return [goal for goal, value in enumerate(table.of("hider/plan")[-1].values) if value is not None]


def test_a_click_on_a_goal_shows_what_the_seeker_would_see_on_the_way(table: Table) -> None:
    play(table, steps=100)
    planned: PredictRequest = table.of("predictor/request")[0]
    goals = open_goals(table)
    goal = goals[len(goals) // 2]
    table.ask(requests.Predict(goal=goal))
    table.run(lambda: bool(table.frames("prediction")))
    header, payload = table.frames("prediction")[-1]
    assert (header["goal"], header["error"], header["episode"]) == (goal, "", planned.episode)
    assert len(header["steps"]) == HORIZONS
    assert header["steps"] == [planned.step + horizon for horizon in chosen_horizons(planned.horizons)]
    path = np.frombuffer(planned.paths, "<f4").reshape(planned.path_count, planned.path_steps, 2)[goals.index(goal)]
    np.testing.assert_allclose(header["path"], path, atol=1e-4)
    reply: PredictReply = table.of("predictor/reply")[-1]
    assert payload == b"".join(reply.views)
    assert len(payload) == HORIZONS * 128 * 128 * 3
    np.testing.assert_array_equal(np.float32(header["caught"]), np.frombuffer(reply.caught, "<f4"))
    # And it is what the planner was told when it painted the value map.
    told: PredictReply = table.of("predictor/reply")[0]
    caught = np.frombuffer(told.caught, "<f4").reshape(planned.path_count, -1)[goals.index(goal)]
    chosen = [planned.horizons.index(horizon) for horizon in chosen_horizons(planned.horizons)]
    np.testing.assert_allclose(header["caught"], caught[chosen], atol=1e-5)


def test_the_consoles_own_questions_are_not_taken_for_the_planners(table: Table) -> None:
    play(table, steps=20)
    goals = open_goals(table)
    for goal in goals[:3]:
        table.ask(requests.Predict(goal=goal))
        table.run(lambda goal=goal: bool(table.frames("prediction")) and table.header("prediction")["goal"] == goal)
        assert table.header("prediction")["error"] == ""


@pytest.mark.parametrize("steps", [1, 5, 9, 10, 40, 100, 1000])
def test_horizons_are_spread_and_end_with_the_last(steps: int) -> None:
    horizons = tuple(10 * (k + 1) - 1 for k in range(steps))
    chosen = chosen_horizons(horizons)
    assert len(chosen) == min(steps, HORIZONS)
    assert chosen[-1] == horizons[-1]
    assert list(chosen) == sorted(set(chosen))
    assert set(chosen) <= set(horizons)
    assert np.ptp(np.diff((-1, *chosen))) <= 20


def test_what_cannot_be_predicted_is_said(table: Table) -> None:
    table.ask(requests.Predict(goal=3))
    table.settle()
    assert "no plan" in table.header("prediction")["error"]
    play(table, steps=20)
    blocked = next(goal for goal in range(GOAL_COUNT) if goal not in open_goals(table))
    table.ask(requests.Predict(goal=blocked))
    table.settle()
    assert "blocked" in table.header("prediction")["error"]
    table.network.sessions["predictor"].close()
    table.runtimes = [runtime for runtime in table.runtimes if runtime.core.declaration.name != "predictor"]
    table.ask(requests.Predict(goal=open_goals(table)[0]))
    table.settle()
    assert table.header("prediction")["error"] == "nobody serves `predictor`: is predictor running?"
    assert table.header("prediction")["goal"] == open_goals(table)[0]


def test_a_predictor_that_hangs_ends_in_an_error(table: Table) -> None:
    play(table, steps=20)
    hanging = table.runtimes.pop([runtime.core.declaration.name for runtime in table.runtimes].index("predictor"))
    table.ask(requests.Predict(goal=open_goals(table)[0]))
    table.run_for(12.0)
    assert "did not answer" in table.header("prediction")["error"]
    assert hanging not in table.runtimes


def test_of_many_clicks_the_newest_is_asked_for_after_the_one_under_way(table: Table) -> None:
    play(table, steps=20)
    goals = open_goals(table)
    before = len(table.of("predictor/request"))
    for goal in goals[:30]:
        table.ask(requests.Predict(goal=goal))
    table.run(lambda: bool(table.frames("prediction")) and table.header("prediction")["goal"] == goals[29])
    assert [header["goal"] for header, _ in table.frames("prediction")] == [goals[0], goals[29]]
    assert len(table.of("predictor/request")) == before + 2


def test_a_console_that_missed_the_planners_question_says_so(table: Table) -> None:
    play(table, steps=20)
    goal = open_goals(table)[0]
    table.restart_console()
    table.come()
    table.settle()
    assert table.header("hider/plan")["predictable"] is False
    table.ask(requests.Predict(goal=goal))
    table.settle()
    assert "was not heard" in table.header("prediction")["error"]


# Past views


def view(step: int, episode: int = 1) -> StateImage:
    return StateImage(stamp=step, episode=episode, step=step, data=bytes([step % 5]) * 128 * 128)


def test_past_views_are_those_of_the_present_game_and_do_not_grow() -> None:
    past = PastViews()
    for step in range(1000):
        past.add(view(step))
    assert len(past._views) == PastViews.LIMIT
    frames = [parse(data) for data in past.frames(requests.Views(episode=1, steps=(999, 600, 599, 5, 2000)))]
    assert [(header["key"], header["step"]) for header, _ in frames] == [("past/999", 999), ("past/600", 600)]
    assert frames[0][1] == view(999).data
    past.add(view(0, episode=2))
    assert not past.frames(requests.Views(episode=1, steps=(999,)))
    assert len(past.frames(requests.Views(episode=2, steps=(0, 1)))) == 1


def test_a_page_gets_the_views_it_asks_for(table: Table) -> None:
    play(table)
    table.ask(requests.Views(episode=table.of("episode")[-1].episode, steps=(0, 3, STEPS + 5)))
    table.settle()
    past = [(header, payload) for header, payload in table.pages.seen[1] if header["key"].startswith("past/")]
    assert [header["key"] for header, _ in past] == ["past/0", "past/3"]
    assert [payload for _, payload in past] == [table.of("seeker/view")[step].data for step in (0, 3)]


# Replays


def playback(table: Table, jumps: int = 0, position: float = 1.0) -> tuple[str, Playback]:
    return "playback", Playback(stamp=table.now, log="table.mcap", position=position, duration=60.0, jumps=jumps)


def test_after_a_jump_nothing_of_before_is_shown(table: Table) -> None:
    play(table)
    table.say("replay", [playback(table)])
    assert table.header("playback") | {"stamp": ""} == {
        "key": "playback",
        "stamp": "",
        "episode": 0,
        "step": 0,
        "log": "table.mcap",
        "position": 1.0,
        "duration": 60.0,
        "speed": 1.0,
        "state": "playing",
        "jumps": 0,
    }
    table.come(2)
    table.settle()
    assert table.frames("hider/plan", 2)
    table.say("replay", [playback(table, jumps=1)])
    assert table.header("playback")["forget"] is True
    table.come(3)
    table.settle()
    keys = [header["key"] for header, _ in table.pages.seen[3]]
    assert set(keys) == {"welcome", "playback", "services", "recording", "score", "session"}
    assert table.header("score", 3)["games"] == 0
    table.say("replay", [playback(table, jumps=1, position=2.0)])
    assert "forget" not in table.header("playback")


def test_a_replay_is_wound_and_paused_and_plays_no_games(table: Table) -> None:
    table.ask(requests.Seek(position=3.0))
    table.settle()
    assert "no replay" in table.notices()[-1]
    table.say("replay", [playback(table)])
    for request in (requests.Start(), requests.Stop(), requests.Discard(episode=1)):
        table.ask(request)
    table.settle()
    assert not table.of("control")
    assert len(table.notices()) == 4
    for wish in (requests.Seek(position=3.5), requests.Pause(), requests.Resume(speed=4.0)):
        table.ask(wish)
    table.settle()
    seek, pause, resume = table.of("control")
    assert (seek.action, seek.position, pause.action, resume.action, resume.speed) == ("seek", 3.5, "pause", "resume", 4.0)


# What pages may cause


def test_a_start_says_what_was_asked(table: Table) -> None:
    table.ask(requests.Start(seed=4, games=2, steps=30, layout="lab", seeker="expert", period=0.1, person="not stored: no human"))
    table.settle()
    control: Control = table.of("control")[-1]
    assert (control.action, control.seed, control.games) == ("start", 4, 2)
    assert (control.rules.maximum_steps, control.rules.layout, control.rules.step_period) == (30, "lab", 0.1)
    assert (control.players.hider, control.players.seeker, control.players.person) == ("planner", "expert", "")


def test_pause_and_resume_where_there_is_nothing_are_refused_in_words(table: Table) -> None:
    table.ask(requests.Pause())
    table.ask(requests.Resume())
    table.settle()
    assert table.notices() == ["there is nothing to pause", "nothing is paused"]
    assert not table.of("control")


def test_a_game_is_paused_and_goes_on(table: Table) -> None:
    table.ask(requests.Start(steps=100))
    table.run(lambda: len(table.of("tick")) > 3)
    table.ask(requests.Pause())
    table.run(lambda: table.of("episode")[-1].paused)
    table.settle()
    assert table.header("session")["paused"] is True
    table.run_for(2.0)
    ticks = len(table.of("tick"))
    table.run_for(3.0)
    assert len(table.of("tick")) == ticks
    table.ask(requests.Resume())
    table.run(lambda: len(table.of("tick")) > ticks + 2)
    assert table.header("session")["paused"] is False


def test_control_is_spoken_at_a_bounded_rate(table: Table) -> None:
    for _ in range(500):
        table.ask(requests.Stop())
    table.settle()
    assert len(table.of("control")) == CONTROLS_BURST
    assert len(table.notices()) == 500 - CONTROLS_BURST
    table.run_for(60.0)
    table.ask(requests.Stop())
    table.settle()
    assert len(table.of("control")) == CONTROLS_BURST + 1


def test_a_request_of_a_page_that_is_gone_is_nothing(table: Table) -> None:
    table.go()
    table.ask(requests.Stop())
    table.settle()
    assert not table.of("control")


def test_a_silent_referee_is_mentioned(table: Table) -> None:
    table.ask(requests.Start())
    table.settle()
    assert "the referee is silent" in table.notices()[-1]
    table.network.sessions["referee"].publish("health/referee", health("referee", table.now))
    table.ask(requests.Start())
    table.settle()
    assert len(table.notices()) == 1


# Health


def test_health_tells_of_a_missing_server_and_of_refusals_for_ten_seconds(table: Table) -> None:
    core = table.core
    assert core.trouble == ""
    core.step(Captured(PAGE, None, table.now, "port 8600 is taken"), table.now)
    assert core.trouble == "port 8600 is taken"
    core.step(Captured(PAGE, None, table.now), table.now)
    assert core.trouble == ""
    table.bus.post(Captured(PAGE, Refusals({"wrong origin": 3}), table.now))
    table.bus.post(Captured(PAGE, Refusals({"wrong origin": 5, "too fast": 1}), table.now))
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
