"""No page makes the console wait: slow ones see the present, silent ones are gone."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.console import server
from services.console.outbox import Outbox
from services.console.server import PING_PERIOD, PONG_PATIENCE
from tests.services.console_game import parse
from tests.services.console_server import PATIENCE, Console
from tests.services.console_socket import BINARY, Socket


@pytest.mark.parametrize("busy", [False, True])
def test_a_page_that_goes_silent_is_gone_within_seconds(console: Console, busy: bool) -> None:
    """No answer to a ping, as when its network is gone: whatever it held would drive on. Also where unsent frames wait for it."""
    with console.open_page() as silent, console.open_page() as honest:
        silent.say('{"type":"drive","primitive":"forward","held":true}')
        console.wait(lambda: len(console.asked) == 1)
        began = time.monotonic()
        if busy:  # more than the kernels take
            console.show("prediction", bytes(16 << 20), client=1)
        while not any(not event.here for event in console.events):
            console.show("hider/color")
            assert honest.receive()[0] == BINARY
            assert time.monotonic() - began < PATIENCE, "it still counts as there"
        assert [event.client for event in console.events if not event.here] == [1]
    assert PING_PERIOD + PONG_PATIENCE <= 3.0, "docs/console.md: three seconds"
    assert console.count("gone silent") == 1


def test_a_page_that_does_not_read_costs_nobody_anything_and_sees_the_present_when_it_does(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(server, "PONG_PATIENCE", 60.0)
    with contextlib.closing(Console(tmp_path)) as console:
        _stop_reading(console)


def _stop_reading(console: Console) -> None:
    picture = os.urandom(320 * 240 * 3)
    with console.open_page() as honest, console.open_page() as sleeping:
        for number in range(300):
            console.show("hider/color", picture, number=number)
            console.show("tick", number=number)
            seen = [parse(honest.receive()[1])[0] for _ in range(2)]
            assert [header["number"] for header in seen] == [number, number]
        late = [parse(sleeping.receive()[1])[0]]
        while late[-1]["key"] != "hider/color" or late[-1]["number"] != 299:
            late.append(parse(sleeping.receive()[1])[0])
        pictures = [header["number"] for header in late if header["key"] == "hider/color"]
        assert pictures == sorted(pictures)
        # What was under way when it stopped reading came late; everything between that and the present was left out.
        assert len(pictures) <= 4


@given(st.lists(st.tuples(st.sampled_from("abcd"), st.booleans()), max_size=60))
def test_of_each_key_the_newest_waits_in_order_of_first_arrival(played: list[tuple[str, bool]]) -> None:
    outbox = Outbox()
    model: dict[str, int] = {}
    for number, (key, takes) in enumerate(played):
        if takes:
            expected = next(iter(model.items()), None)
            taken = outbox.take()
            assert taken == (None if expected is None else b"%d" % expected[1])
            if expected is not None:
                del model[expected[0]]
        else:
            outbox.put(key, b"%d" % number)
            model[key] = number
        assert len(outbox) == len(model) <= 4


def test_an_outbox_is_bounded_and_forgets() -> None:
    outbox = Outbox()
    for number in range(10_000):
        outbox.put(f"past/{number}", b"x")
    assert len(outbox) == Outbox.KEYS
    outbox.put("playback", b"y", forget=True)
    assert (outbox.take(), outbox.take()) == (b"y", None)


def test_a_welcome_and_a_notice_outlive_what_is_forgotten(console: Console) -> None:
    outbox = Outbox()
    for key in ("welcome", "episode", "notice", "hider/view"):
        outbox.put(key, key.encode())
    outbox.put("playback", b"playback", forget=True)
    assert [outbox.take() for _ in range(4)] == [b"welcome", b"notice", b"playback", None]
    # And already before the event loop has come to hand them out.
    with console.server._lock:
        console.server._woken = True
    for key in ("welcome", "tick", "notice"):
        console.show(key, client=1)
    console.show("playback", forget=True)
    assert list(console.server._unsent) == [(1, "welcome"), (1, "notice"), (0, "forget")]


def test_a_page_is_told_to_forget_whatever_comes_after(console: Console) -> None:
    """A replay says where it is twice a second; a page that is slow by then has still to hear that it jumped."""
    outbox = Outbox()
    outbox.put("playback", b"jumped", forget=True)
    for frame in (b"plays", b"plays on"):
        outbox.put("playback", frame)
    assert [outbox.take() for _ in range(3)] == [b"jumped", b"plays on", None]
    # And already before the event loop has come to hand them out.
    with console.open_page() as opened:
        with console.server._lock:
            console.server._woken = True
        console.show("playback", forget=True, number=1)
        console.show("playback", number=2)
        console.server._woken = False
        console.show("playback", number=3)
        heads: list[dict[str, object]] = []
        while not heads or heads[-1].get("number") != 3:
            heads.append(parse(opened.receive()[1])[0])
    told = [(head["number"], head.get("forget", False)) for head in heads if head["key"] == "playback"]
    assert told == [(1, True), (3, False)]


def test_no_frame_comes_before_the_welcome(tmp_path: Path) -> None:
    console = Console(tmp_path)
    try:
        stop = threading.Event()

        def show() -> None:
            while not stop.is_set():
                console.show("tick")

        showing = threading.Thread(target=show)
        showing.start()
        for _ in range(20):
            with Socket(console.target) as opened:
                assert parse(opened.receive()[1])[0]["key"] == "welcome"
        stop.set()
        showing.join()
    finally:
        console.close()


def test_what_the_past_held_is_not_sent_after_a_jump(console: Console) -> None:
    with console.open_page() as opened:
        for number in range(50):
            console.show("hider/color", bytes(230_400), number=number)
            console.show("past/3", bytes(16384))
        console.show("playback", forget=True, jumps=1)
        console.show("tick")
        keys: list[str] = []
        while not keys or keys[-1] != "tick":
            keys.append(parse(opened.receive()[1])[0]["key"])
        assert keys[-2:] == ["playback", "tick"]


def test_a_frame_for_one_page_does_not_overtake_a_later_one_for_all(console: Console) -> None:
    with console.open_page() as opened:
        client = console.events[0].client

        def show() -> None:
            console.show("episode", number=1)
            console.show("episode", client=client, number=2)
            console.show("episode", number=3)
            console.show("tick")

        loop = console.server._loop
        assert loop is not None
        loop.call_soon_threadsafe(show)  # within one turn of the loop: all of it waits together
        headers = []
        while not headers or headers[-1]["key"] != "tick":
            headers.append(parse(opened.receive()[1])[0])
        assert [header["number"] for header in headers[:-1]][-1] == 3
