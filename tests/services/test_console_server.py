"""The page's web server, the real one on a free port: what it serves, where it listens, how it comes and goes."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from services.console import requests, server
from services.console.application import TYPES, files
from services.console.server import DEFAULT_PORT, PageServer, ServerSettings
from tests.services.console_game import parse
from tests.services.console_server import PATIENCE, Console, get
from tests.services.console_socket import BINARY, Socket
from vantage.service import DeviceLost


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
    """A delayed acknowledgement takes 40 ms: the kernel is told not to wait for it."""
    with console.open_page():
        assert console.server._server is not None
        sockets = [each.transport.get_extra_info("socket") for each in console.server._server.server_state.connections]
        assert [each.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0 for each in sockets] == [True]


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


# Coming and going


def test_a_taken_port_is_said_in_words(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        page_server = PageServer(ServerSettings(port=port), tmp_path)
        with pytest.raises(DeviceLost, match=rf"port {port} is taken on 127.0.0.1: .*--port"):
            page_server.open()
        assert page_server.port == 0
    page_server.open()
    assert page_server.port == port
    page_server.close()


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
    first.close()
    assert page.outcome() == "closed 1012"
    page.raw.close()
    second = Console(tmp_path)
    try:
        assert second.target.port == first.target.port
        with second.open_page():
            pass
    finally:
        second.close()


def test_closing_waits_for_nothing_that_pages_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        server, "STOP_PATIENCE", PATIENCE
    )  # a busy machine takes its time; a server that waits for a page never ends
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
    console.server.close()
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
