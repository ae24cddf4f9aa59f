"""Whom the page's web server refuses; and hostile requests of all kinds while a game runs."""

from __future__ import annotations

import random
import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.console.guard import Guard, token_of
from services.console.refused import RefusedLately
from tests.services.console_arena import Arena
from tests.services.console_attacks import ATTACKS, attack, no_token
from tests.services.console_server import Console, get
from tests.services.console_socket import Socket, answered, head
from vantage.deployment import CONSOLE_ADDRESS


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


def test_loopback_wants_the_token_too_because_other_users_reach_it(console: Console, tmp_path: Path) -> None:
    source = random.Random(1)
    for _ in range(20):
        assert no_token(console.target, source) == "403"
    assert not console.events
    with console.open_page():
        pass
    address = (tmp_path / CONSOLE_ADDRESS).read_text()
    assert address == f"http://127.0.0.1:{console.target.port}/#token={token_of(tmp_path)}\n"
    assert get(console.target, "/")[0] == 200, "the page itself holds no secret"


def test_a_guard_without_a_token_admits_no_page() -> None:
    guard = Guard("127.0.0.1", "right")
    assert guard.admits(["vantage", "right"])
    assert not any(guard.admits(offered) for offered in ([], [""], ["vantage"], ["righ"], ["rightx"], ["r\xefght"]))


def test_a_page_of_an_earlier_deployment_does_not_degrade_the_console() -> None:
    refused = RefusedLately()
    refused.add({"wrong token": 30, "no token": 2}, now=0)
    assert refused.trouble == ""


names = st.text("abcdefghijklmnopqrstuvwxyz0123456789.-", min_size=1, max_size=20)


@given(names, st.integers(1, 65535))
def test_no_name_but_this_machines_passes_the_guard(name: str, port: int) -> None:
    guard = Guard("127.0.0.1", "secret")
    own = name in ("localhost", "127.0.0.1")
    assert guard.knows(f"{name}:{port}") == own
    assert (guard.refusal([f"localhost:{port}"], [f"http://{name}:{port}"], True) == "") == (name == "localhost")
    assert guard.refusal([f"localhost:{port}"] * 2, [], False) == "wrong host"


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
        assert not any(arena.lost.values())
    assert arena.console.returncode == 0
