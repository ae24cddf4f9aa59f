"""The playback against a reference that works everything out anew from the whole log."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from schemas import TOPICS, Episode, Layout, Message, Tick, decode
from tests.replay.games import MALFORMED, MILLISECOND, UNKNOWN, WISH, ListedSource, game, recorded
from vantage.log.reader import Record
from vantage.replay.playback import BATCH, LAG, SECOND, SETTLE, SILENCE, Playback, Said

STEP = 10 * MILLISECOND
LEFT_OUT = {"control"}


def is_played(key: str, publisher: str) -> bool:
    return key not in LEFT_OUT


def content(record: Record) -> Message | None:
    """What a record says, if it can be played."""
    if record.key not in TOPICS or record.key in LEFT_OUT or record.payload == MALFORMED[1]:
        return None
    return decode(TOPICS[record.key].type, record.payload)


def state_at(records: list[Record], position: int) -> list[tuple[str, Message]]:
    """What must be said after a jump, in any order but for the first: worked out from every record up to there."""
    reached = [record for record in records if record.log_time <= position]
    silent = {record.key for record in reached if record.key.startswith("health/")}
    silent -= {record.key for record in reached if position - record.log_time < SILENCE}
    past = [(record.key, message) for record in reached if record.key not in silent and (message := content(record))]
    words = [message for _, message in past if isinstance(message, Episode)]
    numbers = [word.episode for word in words if word.phase == "setup" or word.episode not in {w.episode for w in words[:-1]}]
    if not words:
        return list({key: (key, message) for key, message in past}.values())
    number = words[-1].episode if words[-1].phase != "aborted" else numbers[-1]
    begun = max(index for index, (_, message) in enumerate(past) if isinstance(message, Episode) and message.phase == "setup")
    own = [(key, message) for key, message in past[begun:] if message.episode == number]
    said = [own[0]]
    running = [each for each in own if isinstance(each[1], Episode) and each[1].phase == "running"]
    ended = [each for each in own if isinstance(each[1], Episode) and each[1].phase in ("ended", "aborted")]
    said += running[-1:] + ended[-1:]
    latest: dict[str, tuple[str, Message]] = {}
    for index, (key, message) in enumerate(past):
        latest[key] = (key, message)
        if message.episode and index < begun:
            latest.pop(key)
    return said + [each for key, each in latest.items() if key != "episode"]


class Reference:
    """How a replay must behave, stepped every `STEP`: kept in one position, compared with all records each time."""

    def __init__(self, records: list[Record], loop: bool) -> None:
        self.records, self.loop = records, loop
        self.start, self.end = records[0].log_time, records[-1].log_time
        self.position: float = self.start - 1
        self.speed = 1.0
        self.paused = self.ended = False
        self.silent = 0  # real ns until the state is said
        self.waits = True
        self.word: Episode | None = None
        self.jumps = self.reached = 0

    def stands(self, paused: bool) -> list[tuple[str, Message]]:
        if self.waits or self.word is None or self.word.phase != "running":
            return []
        return [("episode", replace(self.word, paused=paused, step=self.reached))]

    def seek(self, position: float) -> None:
        self.jumps += 1
        self.position = min(max(self.start + position, self.start), self.end)
        self.waits, self.silent, self.ended = True, SETTLE, False

    def step(self, elapsed: int) -> list[tuple[str, Message]]:
        if self.waits:
            self.silent -= elapsed
            if self.silent > 0:
                return []
            self.waits = False
            said = state_at(self.records, int(self.position))
            self.word = next((m for _, m in reversed(said) if isinstance(m, Episode)), None)
            self.reached = next((m.step for _, m in said if isinstance(m, Tick)), 0)
            return said + (self.stands(True) if self.paused else [])
        if self.paused or self.ended:
            return []
        before, self.position = self.position, self.position + elapsed * self.speed
        due = [record for record in self.records if before < record.log_time <= self.position]
        said = [(record.key, message) for record in due if (message := content(record))]
        self.word = next((m for _, m in reversed(said) if isinstance(m, Episode)), self.word)
        self.reached = next((m.step for _, m in reversed(said) if isinstance(m, Episode | Tick)), self.reached)
        if not [record for record in self.records if record.log_time > self.position]:
            if self.loop:
                self.seek(0)
            else:
                self.position, self.ended = self.end, True
                said += self.stands(True)
        return said


@st.composite
def logs(draw: st.DrawFn) -> list[Record]:
    said: list[Any] = draw(st.lists(st.sampled_from([WISH, MALFORMED, UNKNOWN]), max_size=2))
    for number in range(draw(st.integers(0, 3))):
        said += game(number + 1, draw(st.integers(0, 5)), draw(st.integers(0, 4)), draw(st.sampled_from(["ended", "aborted"])))
        said += draw(st.lists(st.sampled_from([WISH, MALFORMED, UNKNOWN]), max_size=2))
    said += game(9, 1, draw(st.integers(0, 3)), "")
    gaps = draw(st.lists(st.integers(1, 100).map(lambda n: 2 * n * MILLISECOND), min_size=1, max_size=5))
    return recorded(said, gaps)


WISHES = st.one_of(
    st.tuples(st.just("wait"), st.integers(1, 40)),
    st.tuples(st.just("pause"), st.none()),
    st.tuples(st.just("resume"), st.sampled_from([None, 0.5, 1.0, 4.0])),
    st.tuples(st.just("seek"), st.integers(-100, 6000).map(lambda n: n * 2 * MILLISECOND)),
    st.tuples(st.just("game"), st.integers(-1, 3)),
)


@settings(max_examples=150, deadline=None)
@given(logs(), st.lists(WISHES, max_size=12), st.booleans())
def test_what_is_said_is_what_a_reference_finds_in_the_whole_log(records: list[Record], wishes: list[Any], loop: bool) -> None:
    now = 50 * SECOND
    source = ListedSource(records)
    playback = Playback(source, is_played, now, loop=loop)
    reference = Reference(records, loop)
    # The first turn says what stands at the beginning: nothing.
    assert playback.turn(now) == [] == reference.step(0)
    for wish, argument in [*wishes, ("wait", 5)]:
        said: list[Said] = []
        expected: list[tuple[str, Message]] = []
        if wish == "pause":
            said += playback.pause(now)
            if not reference.paused:
                reference.paused = True
                expected += reference.stands(True)
        elif wish == "resume":
            said += playback.resume(now, argument)
            reference.speed = argument or reference.speed
            if reference.ended:
                reference.seek(0)
            elif reference.paused:
                expected += reference.stands(False)
            reference.paused = False
        elif wish == "seek":
            playback.seek(argument / SECOND, now)
            reference.seek(argument)
        elif wish == "game":
            playback.seek_game(argument, now)
            starts = [game.start for game in source.games]
            if argument < len(starts):
                reference.seek(0 if argument < 0 else starts[argument] - reference.start)
        else:
            for _ in range(argument):
                now += STEP
                said += playback.turn(now)
                expected += reference.step(STEP)
        got = [(each.key, each.message) for each in said]
        assert sorted(map(repr, got)) == sorted(map(repr, expected))
        assert in_order(got)
        report = playback.report(now)
        assert report.jumps == reference.jumps
        assert report.state == ("ended" if reference.ended else "paused" if reference.paused else "playing")
        assert playback.position(now) == pytest.approx(reference.position, abs=1)
        assert report.duration == (records[-1].log_time - records[0].log_time) / SECOND


def in_order(said: list[tuple[str, Message]]) -> bool:
    """Steps go forward from each set-up on, and nothing of a game comes before its set-up."""
    place = (0, 0)
    for _, message in said:
        if isinstance(message, Episode):
            place = (message.episode, 0) if message.phase == "setup" else place
        elif isinstance(message, Tick):
            if (message.episode, message.step) < place:
                return False
            place = (message.episode, message.step)
    return True


def play(playback: Playback, now: int, seconds: float) -> tuple[list[Said], int]:
    said: list[Said] = []
    for _ in range(round(seconds * SECOND / STEP)):
        now += STEP
        said += playback.turn(now)
    return said, now


def test_a_jump_into_a_game_says_its_set_up_first_then_that_it_runs_then_the_layout() -> None:
    records = recorded(game(1, 5, 6, "ended") + game(2, 6, 6, "ended"), [100 * MILLISECOND])
    playback = Playback(ListedSource(records), is_played, 0)
    playback.seek_game(1, 0)
    playback.seek_by(1.5, 0)
    assert playback.turn(SETTLE - 1) == []
    said = playback.turn(SETTLE)
    assert [each.message.phase for each in said[:2]] == ["setup", "running"]  # type: ignore[attr-defined]
    assert isinstance(said[2].message, Layout)
    assert all(each.message.episode in (0, 2) for each in said)
    assert {each.key for each in said} >= {"tick", "hider/pose", "hider/command", "health/planner"}
    assert playback.report(SETTLE).step == max(each.message.step for each in said if each.key == "tick")


def test_of_an_earlier_game_with_the_same_number_nothing_is_said() -> None:
    source = ListedSource(recorded(game(1, 5, 6, "ended") + game(1, 6, 6, "ended"), [100 * MILLISECOND]))
    playback = Playback(source, is_played, 0, position=source.games[1].start)
    said = playback.turn(SETTLE)
    assert sorted(each.key for each in said) == ["episode", "health/planner"], "its own layout, poses and ticks are to come"
    assert isinstance(said[0].message, Episode) and (said[0].message.phase, said[0].message.seed) == ("setup", 6)


def test_a_log_that_begins_within_a_game_gets_a_set_up_made_from_its_first_word() -> None:
    records = recorded(game(4, 5, 6, "ended")[3:], [100 * MILLISECOND])
    playback = Playback(ListedSource(records), is_played, 0, position=records[10].log_time)
    said, _ = play(playback, 0, 0.2)
    setup, running = (each.message for each in said[:2])
    assert isinstance(setup, Episode) and (setup.phase, setup.step, setup.episode) == ("setup", 0, 4)
    assert isinstance(running, Episode) and running.phase == "running"


def test_a_pause_within_a_game_is_said_by_the_referee_and_so_is_its_end() -> None:
    playback = Playback(ListedSource(recorded(game(1, 5, 6, "ended"), [100 * MILLISECOND])), is_played, 0)
    _, now = play(playback, 0, 1.0)
    (held,) = playback.pause(now)
    assert isinstance(held.message, Episode)
    assert (held.key, held.publisher, held.message.phase, held.message.paused) == ("episode", "referee", "running", True)
    nothing, now = play(playback, now, 5.0)
    assert nothing == [] and playback.wake_at(now) is None
    (goes_on,) = playback.resume(now)
    assert isinstance(goes_on.message, Episode) and not goes_on.message.paused
    said, _ = play(playback, now, 0.35)
    assert len(said) == 4  # those of 1.0 to 1.3 s


def test_who_was_held_up_does_not_shout_afterwards() -> None:
    """After a minute in which nothing could be said, what was due goes on from where it was, at its own pace."""
    records = recorded(game(1, 5, 200, "ended"), [10 * MILLISECOND])
    playback = Playback(ListedSource(records), is_played, 0)
    playback.turn(0)
    late = 60 * SECOND
    assert len(playback.turn(late)) == BATCH
    said, _ = play(playback, late, 0.1)
    assert len(said) in range(9, 13)
    assert playback.position(late + LAG) - records[0].log_time < 2 * SECOND


def test_everything_comes_even_where_more_is_due_than_can_be_said_at_once() -> None:
    records = recorded(game(1, 5, 100, "ended"), [MILLISECOND])
    playback = Playback(ListedSource(records), is_played, 0, speed=100.0)
    playback.turn(0)
    said, now = [], 0
    while playback.state != "ended":
        now += STEP
        said += playback.turn(now)
        assert now < 10 * SECOND
    assert len(said) == len(records)


def test_what_cannot_be_played_is_counted() -> None:
    playback = Playback(ListedSource(recorded([MALFORMED, UNKNOWN, UNKNOWN, *game(1, 5, 1, "ended")], [1])), is_played, 0)
    playback.turn(0)
    play(playback, 0, 0.1)
    assert playback.skipped == {"malformed": 1, "on a key that is not in the topic table": 2}
