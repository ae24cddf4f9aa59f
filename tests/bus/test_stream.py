"""A lossless stream against a publisher and a network that lose, delay and forget in every way."""

from __future__ import annotations

from collections import deque

from hypothesis import given, settings
from hypothesis import strategies as st

from vantage.bus.stream import CATCH_UP, Missing, Stream


class Publisher:
    """Publishes 0, 1, 2, ... and keeps the last `cache`."""

    def __init__(self, cache: int) -> None:
        self.count = 0
        self.cache: deque[int] = deque(maxlen=cache)

    def publish(self) -> int:
        self.cache.append(self.count)
        self.count += 1
        return self.count - 1

    def answers(self, question: str) -> list[int]:
        name, _, value = question.partition("=")
        if name == "_max":
            return list(self.cache)[-int(value) :]
        first, _, last = value.partition("..")
        return [sequence for sequence in self.cache if int(first) <= sequence <= int(last or self.count)]


class Reader:
    """Subscribed when the publisher had published `since` messages, or before the publisher started: then 0.

    Args:
        clock: whether reader and publisher share one.
    """

    def __init__(self, stream: Stream[int], publisher: Publisher, since: int, first: int = 0, clock: bool = True) -> None:
        self.stream = stream
        self.publisher = publisher
        self.since = since
        self.clock = clock
        self.delivered: list[int] = []
        self.missing = 0
        self.first = first  # what is owed, if there is no history
        self.position: int | None = None
        self.asked: str | None = None

    def take(self, items: list[int | Missing]) -> None:
        for item in items:
            if isinstance(item, Missing):
                assert item.count > 0
                self.missing += item.count
                self.position = (self.first if self.position is None else self.position) + item.count
            else:
                assert self.position in (None, item)
                self.position = item + 1
                self.delivered.append(item)

    def ask(self) -> None:
        question = self.stream.question()
        if question is not None:
            assert self.asked is None
            self.asked = question

    def answer(self, reaches: bool, stops: int = 10**6) -> None:
        """The question reaches the publisher, or its time is over; of the answers, only the first `stops` come through.

        Those to the first question all do: who joins on part of them may get more history than it wanted.
        """
        stops = 10**6 if self.stream.next is None else stops
        if self.asked is None:
            return
        question, self.asked = self.asked, None
        for sequence in self.publisher.answers(question)[:stops] if reaches else []:
            old = sequence < self.since if self.clock else None
            self.take(self.stream.answered(sequence, sequence, old=old, owes_all=self.clock and self.since == 0))
        self.take(self.stream.ended())
        self.ask()

    def hear(self, sequence: int) -> None:
        self.take(self.stream.arrived(sequence, sequence, owes_all=self.clock and self.since == 0))
        self.ask()

    def beat(self) -> None:
        self.stream.announced(self.publisher.count - 1)
        self.ask()

    def settle(self) -> None:
        self.answer(False)
        self.beat()
        for _ in range(100):
            self.answer(True)
            self.beat()


steps = st.lists(
    st.sampled_from(["heard", "dropped", "beat", "answer", "half answered", "unanswered", "left", "abandoned"]), max_size=200
)


@given(steps, st.integers(1, 40), st.integers(0, 30), st.integers(0, 5))
@settings(max_examples=300, deadline=None)
def test_everything_since_is_delivered_in_order_or_counted(events: list[str], cache: int, before: int, history: int) -> None:
    publisher = Publisher(cache)
    for _ in range(before):
        publisher.publish()
    reader = Reader(Stream(history, 1000), publisher, since=before, first=before)
    for event in events:
        if event == "heard":
            reader.hear(publisher.publish())
        elif event == "dropped":
            publisher.publish()
        elif event == "beat":
            reader.beat()
        elif event == "left":
            reader.stream.left()
        elif event == "abandoned":
            reader.take(reader.stream.abandon())
            reader.ask()
        else:
            reader.answer(event != "unanswered", 2 if event == "half answered" else 1000)
    reader.settle()
    assert reader.position in (None, publisher.count)
    assert reader.position is not None or publisher.count == before
    assert len([sequence for sequence in reader.delivered if sequence < before]) <= history
    assert not reader.stream.held


@given(steps, st.integers(0, 5))
@settings(max_examples=300, deadline=None)
def test_nothing_is_missing_while_the_cache_suffices(events: list[str], history: int) -> None:
    publisher = Publisher(1000)
    for _ in range(10):
        publisher.publish()
    reader = Reader(Stream(history, 1000), publisher, since=10)
    for event in events:
        if event == "heard":
            reader.hear(publisher.publish())
        elif event == "dropped":
            publisher.publish()
        elif event == "beat":
            reader.beat()
        elif "answer" in event:
            reader.answer(event != "unanswered", 2 if event == "half answered" else 1000)
    reader.settle()
    assert reader.missing == 0
    assert reader.delivered == list(range(10 - history, publisher.count))


def test_publisher_that_started_later_is_owed_from_its_first_message() -> None:
    for cache, missing in ((1000, 0), (30, 71)):
        publisher = Publisher(cache)
        for _ in range(100):
            publisher.publish()
        reader = Reader(Stream(1, 1000), publisher, since=0)
        reader.hear(publisher.publish())
        reader.answer(True)
        assert reader.delivered == []
        reader.settle()
        assert reader.missing == missing
        assert reader.delivered == list(range(missing, 101))


def test_late_joiner_asks_for_no_more_than_it_needs() -> None:
    publisher = Publisher(1000)
    for _ in range(500):
        publisher.publish()
    reader = Reader(Stream(1, 1000), publisher, since=500)
    reader.hear(publisher.publish())
    assert reader.asked == f"_max={CATCH_UP}"
    reader.answer(True)
    assert reader.delivered == [499, 500]
    assert reader.asked is None


def test_messages_wait_no_longer_than_the_limit_for_missing_ones() -> None:
    stream: Stream[int] = Stream(0, 5)
    assert stream.arrived(0, 0) == [0]
    assert stream.question() is None
    for sequence in range(2, 7):
        assert stream.arrived(sequence, sequence) == []
    assert stream.question() == "_sn=1..16"
    assert stream.arrived(7, 7) == [Missing(1), 2, 3, 4, 5, 6, 7]


def test_publisher_out_of_reach_is_waited_for_until_it_is_given_up() -> None:
    stream: Stream[int] = Stream(0, 100)
    stream.arrived(0, 0)
    stream.arrived(3, 3)
    stream.announced(5)
    assert stream.question() == "_sn=1..16"
    assert stream.left()
    assert stream.ended() == []
    assert stream.question() is None
    stream.announced(5)
    assert stream.abandon() == []
    assert stream.question() == "_sn=1.."
    assert stream.ended() == []
    assert stream.left()
    assert stream.abandon() == [Missing(2), 3, Missing(2)]
    assert not stream.left()


@given(steps, st.integers(1, 30), st.integers(0, 5))
@settings(max_examples=300, deadline=None)
def test_without_a_common_clock_what_arrives_live_and_all_that_follows_is_delivered(
    events: list[str], before: int, history: int
) -> None:
    """And of what was there before no more than the wanted history, whatever the network loses."""
    publisher = Publisher(1000)
    for _ in range(before):
        publisher.publish()
    reader = Reader(Stream(history, 1000), publisher, since=before, clock=False)
    first_live: int | None = None
    for event in events:
        if event == "heard":
            first_live = publisher.count if first_live is None else first_live
            reader.hear(publisher.publish())
        elif event == "dropped":
            publisher.publish()
        elif event == "beat":
            reader.beat()
        elif "answer" in event:
            reader.answer(event != "unanswered", 2 if event == "half answered" else 1000)
    reader.settle()
    assert reader.missing == 0
    assert reader.delivered == list(range(publisher.count - len(reader.delivered), publisher.count))
    assert len([sequence for sequence in reader.delivered if sequence < before]) <= history
    if first_live is not None:
        assert first_live in reader.delivered
