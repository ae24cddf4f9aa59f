"""What pages say: malformed, huge, too much, too slow."""

from __future__ import annotations

import contextlib
import json
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.console import protocols, requests
from services.console.application import BURST, PAGES_LIMIT
from services.console.rate import Rate
from services.console.requests import MESSAGE_LIMIT, MalformedRequest, decode_request
from tests.services.console_game import parse
from tests.services.console_server import PATIENCE, Console
from tests.services.console_socket import BINARY, PING, TEXT, Socket, head, message, upgrade


def test_what_is_no_request_gets_a_notice_and_the_page_goes_on(console: Console) -> None:
    with console.open_page() as opened:
        for number, text in enumerate(("{", '{"type":"publish","key":"episode"}', '{"type":"predict","goal":500}'), start=1):
            opened.say(text)
            header, _ = parse(opened.receive()[1])
            assert (header["key"], header["level"]) == ("notice", "error")
            assert console.count("malformed request") == number
        opened.say('{"type":"stop"}')
        console.wait(lambda: console.asked == [requests.Stop()])


@given(st.text(max_size=200) | st.binary(max_size=50).map(lambda data: data.decode("latin-1")))
def test_text_is_a_request_or_malformed_and_nothing_else(text: str) -> None:
    try:
        request = decode_request(text)
    except MalformedRequest:
        return
    assert json.loads(text)["type"] == type(request).__name__.lower()


def test_a_request_is_as_long_as_a_message_may_be() -> None:
    with pytest.raises(MalformedRequest, match="at most"):
        decode_request(" " * (MESSAGE_LIMIT + 1))
    assert decode_request('{"type":"stop"}' + " " * (MESSAGE_LIMIT - 15)) == requests.Stop()


def test_binary_and_huge_messages_end_the_connection(console: Console) -> None:
    with console.open_page() as opened:
        opened.raw.sendall(message(BINARY, b"x"))
        assert opened.outcome() == "closed 1003"
    with console.open_page() as opened:
        opened.raw.sendall(message(TEXT, b" " * (MESSAGE_LIMIT + 1)))
        assert opened.outcome() == "closed 1009"
    console.wait(lambda: sum(not event.here for event in console.events) == 2)
    assert not console.asked
    assert (console.count("binary message"), console.count("huge message")) == (1, 1)


def test_too_many_requests_end_the_connection(console: Console) -> None:
    with console.open_page() as opened:
        opened.raw.sendall(message(TEXT, b'{"type":"stop"}') * 300)
        assert opened.outcome() == "closed 1008"
    console.wait(lambda: any(not event.here for event in console.events))
    assert BURST <= len(console.asked) <= BURST + 10
    assert console.count("too fast") >= 1


def test_a_bucket_fills_at_its_rate() -> None:
    rate = Rate(10.0, 5.0)
    assert sum(rate.take(0.0) for _ in range(100)) == 5
    assert sum(rate.take(1.0) for _ in range(100)) == 5
    assert sum(rate.take(1.0 + 0.01 * number) for number in range(101)) == pytest.approx(10, abs=1)
    assert not rate.take(0.0)


def test_a_flood_of_pings_is_cut_off_and_others_go_on(console: Console) -> None:
    with console.open_page() as honest, console.open_page() as flooding:
        with contextlib.suppress(ConnectionError):
            for _ in range(50):
                flooding.raw.sendall(message(PING, b"p" * 120) * 100)
        console.wait(lambda: any(not event.here for event in console.events))
        console.show("tick")
        assert parse(honest.receive()[1])[0]["key"] == "tick"


def test_only_so_many_pages_are_open(console: Console) -> None:
    opened = [console.open_page() for _ in range(PAGES_LIMIT)]
    with Socket(console.target) as one_more:
        assert one_more.outcome() == "closed 1013"
    assert console.count("too many pages") == 1
    opened[0].raw.close()
    console.wait(lambda: any(not event.here for event in console.events))
    with console.open_page():
        pass
    for page in opened[1:]:
        page.raw.close()


def test_begun_handshakes_never_keep_a_page_out(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocols, "HANDSHAKE_PATIENCE", 3600.0)
    with console.open_page() as honest:
        begun = []
        for number in range(2 * protocols.CONNECTIONS_LIMIT):
            begun.append(console.target.connect())
            begun[-1].sendall(upgrade(console.target)[: 10 + number])
        console.wait(lambda: console.count("too many connections") >= protocols.CONNECTIONS_LIMIT)
        with console.open_page() as another:
            console.show("tick")
            assert parse(another.receive()[1])[0]["key"] == "tick"
            assert parse(honest.receive()[1])[0]["key"] == "tick"
        for connection in begun:
            connection.close()


def test_slow_handshakes_are_ended(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocols, "HANDSHAKE_PATIENCE", 0.5)
    begun = [console.target.connect() for _ in range(8)]
    for connection in begun:
        connection.sendall(upgrade(console.target)[:20])
    for connection in begun:
        connection.settimeout(PATIENCE)
        with contextlib.suppress(ConnectionError):
            assert connection.recv(100) == b""
        connection.close()
    console.wait(lambda: console.count("too slow") == len(begun))


def test_a_body_that_never_ends_is_cut_off(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    with console.target.connect() as connection:
        connection.sendall(head("GET / HTTP/1.1", {"Host": console.target.name, "Content-Length": "1000000"}))
        with contextlib.suppress(ConnectionError):
            while True:
                connection.sendall(b"x" * 4096)
                time.sleep(0.001)
    assert console.count("huge request") == 1
