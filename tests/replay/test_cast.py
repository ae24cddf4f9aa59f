"""Who says what in a replay."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from schemas import SERVICES, TOPICS
from vantage.replay.cast import REPLAY, cast

PAIRS = [(key, publisher) for key, topic in TOPICS.items() for publisher in topic.publishers]
STRANGE = [("nobody/declared", "planner"), ("tick", "planner"), ("tick", "")]


@given(st.sets(st.sampled_from(PAIRS + STRANGE)), st.sets(st.sampled_from(SERVICES)), st.sets(st.sampled_from(SERVICES)))
def test_everybody_is_accounted_for_and_nobody_speaks_for_the_living(
    publishers: set[tuple[str, str]], alive: set[str], without: set[str]
) -> None:
    result = cast(publishers, alive, without)
    assert set(result.sessions()).isdisjoint(alive | without)
    for (key, publisher), voice in result.voices.items():
        assert voice in TOPICS[key].publishers, "receivers set aside what a stranger says"
        assert voice == publisher or publisher in alive
    for key, publisher in publishers:
        played = (key, publisher) in result.voices
        assert played or publisher in result.replaced or (key, publisher) in result.unplayable or key in ("control", "playback")
        assert not (played and key in ("control", "playback"))
    assert all(name in alive or "as you wish" in how for name, how in result.replaced.items())


def test_what_the_recorded_predictor_said_comes_from_the_replay_unless_a_live_planner_asks_for_itself() -> None:
    said = {("predictor/request", "predictor"), ("predictor/reply", "predictor"), ("health/predictor", "predictor")}
    beside = cast(said, {"predictor"}, set())
    assert beside.voices == {("predictor/request", "predictor"): REPLAY, ("predictor/reply", "predictor"): REPLAY}
    assert cast(said, {"predictor", "planner"}, set()).voices == {}
    assert cast(said, {"predictor"}, {"planner"}).voices == {}
    assert set(cast(said, set(), set()).voices.values()) == {"predictor"}
    assert cast(said, set(), {"predictor"}).voices == {}, "who is left out is not spoken for"


def test_what_a_human_drove_is_not_missing_beside_a_live_console() -> None:
    said = {("hider/command", "console"), ("hider/view", "console"), ("health/console", "console"), ("tick", "referee")}
    result = cast(said, {"console"}, set())
    assert result.voices == {
        ("hider/command", "console"): "hider",
        ("hider/view", "console"): "hider",
        ("tick", "referee"): "referee",
    }
    assert result.replaced == {"console": "played by the live console instead"}
    assert cast(said, set(), {"console"}).voices == {("tick", "referee"): "referee"}
