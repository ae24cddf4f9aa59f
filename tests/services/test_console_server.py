"""The page's web server, the real one on a free port: what it serves, whom it refuses, and that nobody makes it wait."""

from __future__ import annotations

import contextlib
import json
import os
import random
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.console_hostile import (
    ATTACKS,
    BINARY,
    PING,
    TEXT,
    Arena,
    Socket,
    Target,
    answered,
    attack,
    head,
    message,
    no_token,
    upgrade,
)
from services.console import protocols, requests, server
from services.console.application import BURST, PAGES_LIMIT, TYPES, files
from services.console.events import PageEvent, Refusals
from services.console.frames import addressed, frame
from services.console.guard import Guard, needs_token, token_of
from services.console.outbox import Outbox
from services.console.rate import Rate
from services.console.requests import MESSAGE_LIMIT, MalformedRequest, decode_request
from services.console.server import DEFAULT_PORT, PING_PERIOD, PONG_PATIENCE, PageServer, ServerSettings
from tests.services.console_game import parse
from vantage.deployment import CONSOLE_ADDRESS
from vantage.service import DeviceLost

PATIENCE = 10.0


class Console:
    """A page server that is read all the time, as the runtime does, and welcomes every page."""

    def __init__(self, folder: Path, host: str = "127.0.0.1", port: int = 0) -> None:
        self.page = folder / "page"
        if not self.page.exists():
            (self.page / "parts").mkdir(parents=True)
            (self.page / "index.html").write_text("<!doctype html><title>Vantage</title>")
            (self.page / "parts" / "draw.js").write_text("export const x = 1;")
            (self.page / "notes.txt").write_text("not served")
            (folder / "secret.js").write_text("secret")
            (self.page / "link.js").symlink_to(folder / "secret.js")
        self.server = PageServer(ServerSettings(host=host, port=port), folder, page=self.page)
        self.server.open()
        self.target = Target(host if host != "0.0.0.0" else "127.0.0.1", self.server.port, self.server.token)
        self.events: list[PageEvent] = []
        self.refused: dict[str, int] = {}
        self._stop = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._stop:
            got = self.server.read()
            if got is None:
                continue
            value, _ = got
            if isinstance(value, Refusals):
                self.refused = value.counts
                continue
            self.events.append(value)
            if value.request is None and value.here:
                self.server.write(addressed(value.client, frame("welcome", {"client": value.client})))

    @property
    def asked(self) -> list[requests.AnyRequest]:
        return [event.request for event in self.events if event.request is not None]

    def wait(self, until: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not until():
            assert time.monotonic() < end, "what was waited for has not come"
            time.sleep(0.005)

    def count(self, reason: str) -> int:
        return self.server._refused[reason]

    def show(self, key: str, payload: bytes = b"", client: int = 0, **fields: object) -> None:
        self.server.write(addressed(client, frame(key, fields, payload)))

    def open_page(self, **changed: str | None) -> Socket:
        opened = Socket(self.target, **changed)
        assert opened.status == 101
        opcode, data = opened.receive()
        assert (opcode, parse(data)[0]["key"]) == (BINARY, "welcome")
        return opened

    def close(self) -> None:
        self._stop = True
        self._thread.join(2.0)
        self.server.close()


@pytest.fixture
def console(tmp_path: Path) -> Iterator[Console]:
    opened = Console(tmp_path)
    yield opened
    opened.close()


@pytest.fixture
def elsewhere(tmp_path: Path) -> Iterator[Console]:
    opened = Console(tmp_path, host="127.0.0.2")
    yield opened
    opened.close()


def get(target: Target, path: str, **more: str) -> tuple[int, dict[str, str], bytes]:
    with target.connect() as connection:
        connection.sendall(head(f"GET {path} HTTP/1.1", {"Host": target.name, "Connection": "close", **more}))
        data = b""
        while got := connection.recv(65536):
            data += got
    top, _, body = data.partition(b"\r\n\r\n")
    lines = top.decode().split("\r\n")
    return (
        int(lines[0].split()[1]),
        {name.lower(): value for name, _, value in (line.partition(": ") for line in lines[1:])},
        body,
    )


# What is served


def test_the_page_is_served_and_nothing_else_of_the_disk(console: Console) -> None:
    status, headers, body = get(console.target, "/")
    assert (status, headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert b"Vantage" in body
    status, headers, _ = get(console.target, "/parts/draw.js")
    assert (status, headers["content-type"]) == (200, "text/javascript; charset=utf-8")
    for path in (
        "/notes.txt",
        "/link.js",
        "/parts/",
        "/parts",
        "/../secret.js",
        "/parts/../index.html",
        "/%2e%2e/secret.js",
        "//",
    ):
        assert get(console.target, path)[0] == 404, path
    assert console.count("no such file") == 8


def test_every_answer_carries_the_security_headers(console: Console) -> None:
    for path, more in (("/", {}), ("/nothing", {}), ("/", {"Origin": "http://evil.example"})):
        _, headers, _ = get(console.target, path, **more)
        assert headers["content-security-policy"].startswith("default-src 'self';")
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-store"
        assert headers["referrer-policy"] == "no-referrer"
        assert "server" not in headers


def test_the_real_page_is_whole_and_asks_nothing_of_others() -> None:
    served = files(Path("services/console/page"))
    assert "/" in served
    for path in served.values():
        assert path.suffix in TYPES
        if path.suffix in (".html", ".js", ".css"):
            text = path.read_text()
            assert "https://" not in text.replace("https://www.w3.org", "")
    html = served["/"].read_text()
    assert "style=" not in html
    assert "onclick=" not in html


def test_frames_come_as_one_binary_message_each_and_to_whom_they_are_for(console: Console) -> None:
    with console.open_page() as one, console.open_page() as two:
        picture = os.urandom(320 * 240 * 3)
        console.show("hider/color", picture, width=320, height=240)
        console.show("prediction", b"xyz", client=2, goal=3)
        for opened in (one, two):
            opcode, data = opened.receive()
            header, payload = parse(data)
            assert opcode == BINARY
            assert header == {"key": "hider/color", "width": 320, "height": 240}
            assert payload == picture
        assert parse(two.receive()[1]) == ({"key": "prediction", "goal": 3}, b"xyz")
        console.show("tick")
        assert parse(one.receive()[1])[0]["key"] == "tick"


def test_small_frames_do_not_wait_for_big_ones_to_be_acknowledged(console: Console) -> None:
    picture = os.urandom(320 * 240 * 3)
    slow = 0
    with console.open_page() as opened:
        for _ in range(100):
            console.show("hider/color", picture)
            console.show("tick")
            opened.receive()
            began = time.perf_counter()
            opened.receive()
            slow += time.perf_counter() - began > 0.035  # a delayed acknowledgement takes 40 ms
    assert slow <= 3


def test_requests_arrive_in_order_with_their_page(console: Console) -> None:
    with console.open_page() as one, console.open_page() as two:
        one.say('{"type":"drive","primitive":"left","held":true}')
        one.say('{"type":"drive","primitive":"left","held":false}')
        console.wait(lambda: len(console.asked) == 2)
        two.say('{"type":"start","seed":7,"hider":"human","person":"Ada"}')
        console.wait(lambda: len(console.asked) == 3)
    console.wait(lambda: sum(not event.here for event in console.events) == 2)
    assert [event.client for event in console.events if event.request is not None] == [1, 1, 2]
    assert console.asked[0] == requests.Drive(primitive="left", held=True)
    assert console.asked[1] == requests.Drive(primitive="left", held=False)
    assert console.asked[2] == requests.Start(seed=7, hider="human", person="Ada")
    assert not console.server._refused


def test_numbers_of_pages_are_not_used_twice(console: Console) -> None:
    for number in range(1, 4):
        with Socket(console.target) as opened:
            assert parse(opened.receive()[1])[0]["client"] == number
    console.wait(lambda: sum(not event.here for event in console.events) == 3)


def test_compression_is_off(console: Console) -> None:
    with console.open_page(Sec_WebSocket_Extensions="permessage-deflate") as opened:
        console.show("hider/view", bytes(16384))
        assert len(opened.receive()[1]) > 16384


# Who is refused


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "", "http://127.0.0.1:1", "http://localhost:{port}", "file://"]
)
def test_a_websocket_of_another_origin_is_refused(console: Console, origin: str) -> None:
    with Socket(console.target, Origin=origin.format(port=console.target.port)) as opened:
        assert opened.status == 403
    assert console.count("wrong origin") == 1
    assert not console.events


def test_a_websocket_without_origin_is_refused(console: Console) -> None:
    with Socket(console.target, Origin=None) as opened:
        assert opened.status == 403
    assert console.count("no origin") == 1


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", "10.0.0.1", "localhost.evil"])
def test_another_host_is_refused_because_its_name_may_be_bound_to_this_machine(console: Console, host: str) -> None:
    assert answered(console.target, head("GET / HTTP/1.1", {"Host": host})) == "403"
    with Socket(console.target, Host=host, Origin=f"http://{host}") as opened:
        assert opened.status == 403
    assert console.count("wrong host") == 2


def test_localhost_is_this_machine(console: Console) -> None:
    name = f"localhost:{console.target.port}"
    with Socket(console.target, Host=name, Origin=f"http://{name}") as opened:
        assert opened.status == 101


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE"])
def test_nothing_is_written_by_http(console: Console, method: str) -> None:
    body = '{"type":"stop"}'
    headers = {"Host": console.target.name, "Content-Length": str(len(body)), "Content-Type": "application/json"}
    for path in ("/", "/bus", "/control"):
        assert answered(console.target, head(f"{method} {path} HTTP/1.1", headers) + body.encode()) == "405"
    assert console.count("wrong method") == 3
    assert not console.events


def test_elsewhere_a_token_is_needed(elsewhere: Console) -> None:
    source = random.Random(1)
    for _ in range(20):
        assert no_token(elsewhere.target, source) == "403"
    assert elsewhere.count("no token") + elsewhere.count("wrong token") == 20
    assert not elsewhere.events
    with elsewhere.open_page():
        pass
    assert get(elsewhere.target, "/")[0] == 200
    assert f"#token={elsewhere.target.token}" in elsewhere.server.address


def test_on_all_addresses_a_token_is_needed_too_and_names_of_others_are_refused(tmp_path: Path) -> None:
    console = Console(tmp_path, host="0.0.0.0")
    try:
        assert no_token(console.target, random.Random(1)) == "403"
        with console.open_page():
            pass
        assert answered(console.target, head("GET / HTTP/1.1", {"Host": "evil.example"})) == "403"
        assert answered(console.target, head("GET / HTTP/1.1", {"Host": f"192.0.2.7:{console.target.port}"})) == "200"
    finally:
        console.close()


def test_the_token_is_private_and_survives_a_restart(tmp_path: Path) -> None:
    first = Console(tmp_path, host="127.0.0.2")
    first.close()
    path = tmp_path / "console.token"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE((tmp_path / CONSOLE_ADDRESS).stat().st_mode) == 0o600
    second = Console(tmp_path, host="127.0.0.2")
    second.close()
    assert first.target.token == second.target.token == token_of(tmp_path)
    assert len(first.target.token) >= 32


def test_loopback_needs_no_token_and_keeps_none(console: Console, tmp_path: Path) -> None:
    assert console.server.token == ""
    assert not (tmp_path / "console.token").exists()
    assert (tmp_path / CONSOLE_ADDRESS).read_text() == f"http://127.0.0.1:{console.target.port}/\n"


names = st.text("abcdefghijklmnopqrstuvwxyz0123456789.-", min_size=1, max_size=20)


@given(names, st.integers(1, 65535))
def test_no_name_but_this_machines_passes_the_guard(name: str, port: int) -> None:
    guard = Guard("127.0.0.1")
    own = name in ("localhost", "127.0.0.1")
    assert guard.knows(f"{name}:{port}") == own
    assert (guard.refusal([f"localhost:{port}"], [f"http://{name}:{port}"], True) == "") == (name == "localhost")
    assert guard.refusal([f"localhost:{port}"] * 2, [], False) == "wrong host"


def test_only_this_machines_own_address_needs_no_token() -> None:
    assert [needs_token(host) for host in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "192.168.1.4", "::", "127.0.0.2")] == [
        *(False, False, False),
        *(True, True, True, True),
    ]


# What is said by pages


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


def test_slow_handshakes_are_ended_and_never_keep_a_page_out(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocols, "HANDSHAKE_PATIENCE", 0.5)
    with console.open_page() as honest:
        begun = []
        for number in range(2 * protocols.CONNECTIONS_LIMIT):
            begun.append(console.target.connect())
            begun[-1].sendall(upgrade(console.target)[: 10 + number])
        with console.open_page() as another:
            console.show("tick")
            assert parse(another.receive()[1])[0]["key"] == "tick"
            assert parse(honest.receive()[1])[0]["key"] == "tick"
            console.wait(lambda: console.count("too slow") >= protocols.CONNECTIONS_LIMIT // 2)
            for connection in begun:
                connection.settimeout(PATIENCE)
                with contextlib.suppress(ConnectionError):
                    assert connection.recv(100) in (b"",)
                connection.close()
    assert console.count("too many connections") >= protocols.CONNECTIONS_LIMIT


def test_a_body_that_never_ends_is_cut_off(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    with console.target.connect() as connection:
        connection.sendall(head("GET / HTTP/1.1", {"Host": console.target.name, "Content-Length": "1000000"}))
        with contextlib.suppress(ConnectionError):
            while True:
                connection.sendall(b"x" * 4096)
                time.sleep(0.001)
    assert console.count("huge request") == 1


# Nobody waits for a browser


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
        assert time.monotonic() - began < PING_PERIOD + PONG_PATIENCE + 1.0
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
        slowest = 0.0
        for number in range(300):
            began = time.perf_counter()
            console.show("hider/color", picture, number=number)
            console.show("tick", number=number)
            slowest = max(slowest, time.perf_counter() - began)
            seen = [parse(honest.receive()[1])[0] for _ in range(2)]
            assert [header["number"] for header in seen] == [number, number]
        assert slowest < 0.25
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
    assert list(console.server._unsent) == [(1, "welcome"), (1, "notice"), (0, "playback")]


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


# Coming and going


def test_a_taken_port_is_said_in_words(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        server = PageServer(ServerSettings(port=port), tmp_path)
        with pytest.raises(DeviceLost, match=rf"port {port} is taken on 127.0.0.1: .*--port"):
            server.open()
        assert server.port == 0
    server.open()
    assert server.port == port
    server.close()


def test_where_the_default_port_is_taken_the_next_free_one_is_used(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    first, second = (PageServer(ServerSettings(), tmp_path / name) for name in ("one", "two"))
    first.open()
    second.open()
    try:
        assert DEFAULT_PORT <= first.port < second.port <= DEFAULT_PORT + 16
    finally:
        first.close()
        second.close()


def test_an_address_that_is_not_of_this_machine_is_said(tmp_path: Path) -> None:
    with pytest.raises(DeviceLost, match=r"cannot listen on 192\.0\.2\.1"):
        PageServer(ServerSettings(host="192.0.2.1"), tmp_path).open()


def test_after_a_restart_it_is_found_at_the_same_place(tmp_path: Path) -> None:
    first = Console(tmp_path)
    page = first.open_page()
    began = time.monotonic()
    first.close()
    assert time.monotonic() - began < 2.0
    assert page.outcome() == "closed 1012"
    page.raw.close()
    second = Console(tmp_path)
    try:
        assert second.target.port == first.target.port
        with second.open_page():
            pass
    finally:
        second.close()


def test_closing_takes_less_than_a_second_whatever_pages_do(tmp_path: Path) -> None:
    console = Console(tmp_path)
    pages = [console.open_page() for _ in range(5)]
    half = console.target.connect()
    half.sendall(b"GET / HTTP/1.1\r\n")
    for _ in range(40):
        console.show("hider/color", bytes(230_400))
    console._stop = True
    console._thread.join()
    serving = console.server._thread
    assert serving is not None
    began = time.monotonic()
    console.server.close()
    assert time.monotonic() - began < 0.9
    assert not serving.is_alive()
    with socket.socket() as next_one:
        next_one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        next_one.bind(("127.0.0.1", console.target.port))
        next_one.listen()
    console.server.close()
    for connection in (half, *(page.raw for page in pages)):
        connection.close()


def test_writing_to_a_closed_server_does_nothing(tmp_path: Path) -> None:
    console = Console(tmp_path)
    console.close()
    console.show("tick")
    assert not console.server._unsent


# All of it, on a real bus


@pytest.mark.stack
def test_none_of_three_hundred_hostile_requests_reaches_the_bus_and_the_game_goes_on() -> None:
    with Arena() as arena:
        arena.bus_ticks.begin()
        arena.page_ticks.begin()
        outcomes, not_refused = attack(arena.target, 15 * len(ATTACKS), seed=2)
        assert sum(outcomes.values()) == 15 * len(ATTACKS)
        assert not not_refused
        assert set(arena.of_console) <= {"health/console"}
        seen = arena.page_ticks.count
        arena.wait(lambda: arena.page_ticks.count > seen + 3, "the page has stopped")
        arena.wait(lambda: any("requests refused" in reason for reason in arena.reasons), "health says nothing")
        assert {phase for _, phase in arena.episodes} <= {"setup", "running"}
        assert arena.bus_ticks.longest < 2.0
        assert arena.page_ticks.longest < 2.0
        assert not any(arena.lost.values())
    assert arena.console.returncode == 0
