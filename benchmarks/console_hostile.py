"""Ten thousand hostile requests against a console on a real bus while a game runs.

    python benchmarks/console_hostile.py                     the whole of it
    python benchmarks/console_hostile.py --requests 500

Wrong origins and hosts, no token, other methods, paths out of the folder, nonsense instead of HTTP, of WebSocket, of JSON, of
requests; huge, endless, far too many, far too slow, never read. Referee, simulator, seeker and a hider play on a Zenoh bus; the
console is the real process. An honest page is open all the while. Said at the end: what was sent and how it was refused, what
the console published, the longest time between two ticks on the bus and at the honest page.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import random
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from learning.hiders.core import HiderCore
from learning.hiders.random_primitives import RandomPrimitives
from schemas import Episode, Health, Players, Rules
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore
from services.simulator.core import SimulatorCore
from vantage.bus import Sample
from vantage.bus.zenoh_bus import ZenohBus
from vantage.deployment import CONSOLE_ADDRESS
from vantage.service import Core, Runtime
from vantage.world.camera import Camera

PATIENCE = 5.0
TEXT, BINARY, CLOSE, PING, PONG, CONTINUATION = 1, 2, 8, 9, 10, 0


@dataclass
class Target:
    """Where the console is, and connections that are left open on purpose."""

    host: str
    port: int
    token: str = ""
    held: list[socket.socket] = field(default_factory=list)

    @property
    def name(self) -> str:
        return f"{self.host}:{self.port}"

    def connect(self) -> socket.socket:
        connection = socket.create_connection((self.host, self.port), timeout=PATIENCE)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection


def head(line: str, headers: dict[str, str]) -> bytes:
    return "\r\n".join([line, *(f"{name}: {value}" for name, value in headers.items()), "", ""]).encode("latin-1")


def upgrade(target: Target, **changed: str | None) -> bytes:
    """The head of a WebSocket's handshake as the real page's browser sends it, with headers changed or left out."""
    headers: dict[str, str | None] = {
        "Host": target.name,
        "Origin": f"http://{target.name}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": base64.b64encode(os.urandom(16)).decode(),
        "Sec-WebSocket-Protocol": ", ".join(["vantage", *([target.token] if target.token else [])]),
        **{name.replace("_", "-"): value for name, value in changed.items()},
    }
    return head("GET /bus HTTP/1.1", {name: value for name, value in headers.items() if value is not None})


def message(opcode: int, data: bytes, final: bool = True, masked: bool = True, reserved: int = 0) -> bytes:
    """A WebSocket frame as a client sends it."""
    first = (0x80 if final else 0) | reserved << 4 | opcode
    size = len(data)
    length = (
        bytes([size]) if size < 126 else b"\x7e" + struct.pack(">H", size) if size < 65536 else b"\x7f" + struct.pack(">Q", size)
    )
    if not masked:
        return bytes([first]) + length + data
    return bytes([first, length[0] | 0x80]) + length[1:] + bytes(4) + data


class Socket:
    """A WebSocket by hand, so that everything can be wrong with it."""

    def __init__(self, target: Target, **changed: str | None) -> None:
        self.raw = target.connect()
        self.raw.sendall(upgrade(target, **changed))
        self._buffer = b""
        while b"\r\n\r\n" not in self._buffer:
            if not (got := self.raw.recv(65536)):
                break
            self._buffer += got
        top, _, self._buffer = self._buffer.partition(b"\r\n\r\n")
        self.status = int(top.split()[1]) if top else 0

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *_: object) -> None:
        self.raw.close()

    def say(self, text: str) -> None:
        self.raw.sendall(message(TEXT, text.encode()))

    def receive(self) -> tuple[int, bytes]:
        """Opcode and data of the next frame but for pings, which are answered; (CLOSE, b"") where the connection is cut."""
        while True:
            opcode, data = self._receive()
            if opcode != PING:
                return opcode, data
            with contextlib.suppress(ConnectionError):
                self.raw.sendall(message(PONG, data))

    def _receive(self) -> tuple[int, bytes]:
        try:
            start = self._exactly(2)
            size = start[1] & 0x7F
            if size == 126:
                (size,) = struct.unpack(">H", self._exactly(2))
            elif size == 127:
                (size,) = struct.unpack(">Q", self._exactly(8))
            return start[0] & 0x0F, self._exactly(size)
        except (ConnectionError, EOFError):
            return CLOSE, b""

    def _exactly(self, count: int) -> bytes:
        while len(self._buffer) < count:
            got = self.raw.recv(1 << 20)
            if not got:
                raise EOFError
            self._buffer += got
        data, self._buffer = self._buffer[:count], self._buffer[count:]
        return data

    def headers(self) -> Iterator[dict[str, object]]:
        """Headers of the console's frames as they come, until it closes."""
        while True:
            opcode, data = self.receive()
            if opcode == CLOSE:
                code = struct.unpack(">H", data[:2])[0] if len(data) >= 2 else 0
                yield {"key": f"closed {code}" if code else "cut off"}
                return
            if opcode == BINARY:
                yield json.loads(data[4 : 4 + int.from_bytes(data[:4], "little")])

    def outcome(self) -> str:
        """What came of it: `notice`, `closed CODE` or `cut off`."""
        return next(str(header["key"]) for header in self.headers() if str(header["key"]).startswith(("notice", "closed", "cut")))


def answered(target: Target, request: bytes) -> str:
    """Send bytes; return the status of the answer, or `cut off`."""
    with target.connect() as connection:
        with contextlib.suppress(ConnectionError):
            connection.sendall(request)
        try:
            first = connection.recv(4096)
        except ConnectionError:
            first = b""
    return first.split()[1].decode() if first.startswith(b"HTTP/") else "cut off"


def _origin(target: Target, source: random.Random) -> str:
    return source.choice(
        ("http://evil.example", "null", f"http://localhost.evil.example:{target.port}", f"http://{target.host}:1", "file://", "")
    )


def _path(source: random.Random) -> str:
    up = source.choice(("../", "..%2f", "%2e%2e/", "....//", "..\\", "/", "%00", "static/../../"))
    where = source.choice(("etc/passwd", "console.token", "core.py", "__main__.py", "index.html%00.js", "pyproject.toml"))
    return "/" + up * source.randint(1, 9) + where


def _nonsense(source: random.Random) -> str:
    """JSON that is none, or no request, or out of bounds."""
    return source.choice(
        (
            "",
            "{",
            "null",
            "[]" * 50,
            "[" * 2000,
            '{"type":"start","seed":-1}',
            '{"type":"start","layout":"/etc/passwd"}',
            '{"type":"start","steps":1e99}',
            '{"type":"start","period":"NaN"}',
            '{"type":"start","hider":"__import__"}',
            '{"type":"drive","primitive":"fly","held":true}',
            '{"type":"drive","primitive":"left"}',
            '{"type":"predict","goal":121}',
            '{"type":"predict","goal":1e400}',
            '{"type":"views","episode":1,"steps":[' + ",".join(["1"] * 65) + "]}",
            '{"type":"seek","position":-1}',
            '{"type":"control","action":"stop"}',
            '{"type":"publish","key":"episode"}',
            '{"type":"stop","stamp":1}',
            '{"type":["stop"]}',
            json.dumps({"type": "start", "person": "x" * 81}),
            "\0" * source.randint(1, 100),
            "".join(chr(source.randint(32, 0x2FF)) for _ in range(source.randint(1, 1000))),
        )
    )


def _wrong_origin_socket(target: Target, source: random.Random) -> str:
    with Socket(target, Origin=_origin(target, source)) as opened:
        return str(opened.status)


def _no_origin(target: Target, source: random.Random) -> str:
    with Socket(target, Origin=None) as opened:
        return str(opened.status)


def _wrong_host(target: Target, source: random.Random) -> str:
    host = source.choice(("evil.example", "evil.example:8600", "127.0.0.1.evil.example", "", "localhost.evil", "10.1.2.3"))
    if source.random() < 0.5:
        return answered(target, head("GET / HTTP/1.1", {"Host": host}))
    with Socket(target, Host=host, Origin=f"http://{host}") as opened:
        return str(opened.status)


def _wrong_origin_page(target: Target, source: random.Random) -> str:
    return answered(target, head("GET / HTTP/1.1", {"Host": target.name, "Origin": _origin(target, source)}))


def _other_method(target: Target, source: random.Random) -> str:
    method = source.choice(("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "CONNECT", "TRACE", "MADE-UP"))
    path = source.choice(("/", "/bus", "/control", "/index.html"))
    body = b'{"type":"stop"}' * source.randint(0, 3)
    return answered(target, head(f"{method} {path} HTTP/1.1", {"Host": target.name, "Content-Length": str(len(body))}) + body)


def _traversal(target: Target, source: random.Random) -> str:
    return answered(target, head(f"GET {_path(source)} HTTP/1.1", {"Host": target.name}))


def _no_http(target: Target, source: random.Random) -> str:
    return answered(target, source.randbytes(source.randint(1, 3000)) + b"\r\n\r\n")


def _huge_head(target: Target, source: random.Random) -> str:
    if source.random() < 0.5:
        return answered(target, f"GET /{'a' * source.randint(20_000, 200_000)} HTTP/1.1\r\nHost: {target.name}\r\n\r\n".encode())
    return answered(target, head("GET / HTTP/1.1", {"Host": target.name, **{f"X-{i}": "y" * 900 for i in range(60)}}))


def _two_hosts(target: Target, source: random.Random) -> str:
    return answered(target, f"GET / HTTP/1.1\r\nHost: {target.name}\r\nHost: evil.example\r\n\r\n".encode())


def _smuggled(target: Target, source: random.Random) -> str:
    lines = f"POST / HTTP/1.1\r\nHost: {target.name}\r\nContent-Length: 4\r\nTransfer-Encoding: chunked\r\n\r\n"
    return answered(target, lines.encode() + b"0\r\n\r\nGET /bus HTTP/1.1\r\n\r\n")


def _nonsense_text(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        opened.say(_nonsense(source))
        return opened.outcome()


def _out_of_place(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        opened.say(
            source.choice(
                (
                    '{"type":"seek","position":3}',
                    '{"type":"resume"}',
                    '{"type":"discard","episode":99999}',
                    '{"type":"start","hider":"human","period":0}',
                )
            )
        )
        return opened.outcome()


def _binary(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        opened.raw.sendall(message(BINARY, source.randbytes(source.randint(0, 4000))))
        return opened.outcome()


def _huge_message(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        with contextlib.suppress(ConnectionError):
            opened.raw.sendall(message(source.choice((TEXT, BINARY)), b" " * source.choice((4097, 20_000, 60_000, 3_000_000))))
        return opened.outcome()


def _claimed_huge(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        opened.raw.sendall(bytes([0x81, 0xFF]) + struct.pack(">Q", source.choice((2**31, 2**62))) + bytes(4) + b"{")
        return opened.outcome()


def _endless_fragments(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        with contextlib.suppress(ConnectionError):
            opened.raw.sendall(message(TEXT, b"{", final=False) + message(CONTINUATION, b"", final=False) * 200)
        return opened.outcome()


def _broken_frames(target: Target, source: random.Random) -> str:
    broken = source.choice(
        (
            message(TEXT, b"{}", masked=False),
            message(TEXT, b"{}", reserved=4),
            message(11, b""),
            message(PING, b"x" * 126),
            message(CONTINUATION, b"{}"),
            message(CLOSE, b"\x00"),
            message(TEXT, b"\xff\xfe\xfd"),
        )
    )
    with Socket(target) as opened:
        opened.raw.sendall(broken)
        return opened.outcome()


def _flood(target: Target, source: random.Random) -> str:
    """A key pressed 300 times at once, in no game of a human: no more than a connection it is."""
    with Socket(target) as opened:
        with contextlib.suppress(ConnectionError):
            opened.raw.sendall(message(TEXT, b'{"type":"drive","primitive":"left","held":true}') * 300)
        return opened.outcome()


def _ping_flood(target: Target, source: random.Random) -> str:
    with Socket(target) as opened:
        with contextlib.suppress(ConnectionError):
            opened.raw.sendall(message(PING, b"p" * 100) * 2000)
        return opened.outcome()


def _half_open(target: Target, source: random.Random) -> str:
    """A handshake that is not finished; the connection is left for the console to close."""
    connection = target.connect()
    whole = upgrade(target)
    connection.sendall(whole[: source.randint(0, len(whole) - 2)])
    target.held.append(connection)
    if len(target.held) > 200:
        target.held.pop(0).close()
    return "left open"


def no_token(target: Target, source: random.Random) -> str:
    """No token, or a wrong one, where the console wants one: it is bound elsewhere than on loopback."""
    token = target.token
    assert token
    wrong = source.choice((None, "vantage", "vantage, " + "x" * 32, f"vantage, {token[:-1]}", f"{token.swapcase()}, vantage"))
    with Socket(target, Sec_WebSocket_Protocol=wrong) as opened:
        return str(opened.status)


Attack = Callable[[Target, random.Random], str]

ATTACKS: dict[str, tuple[Attack, frozenset[str]]] = {
    "WebSocket of another origin": (_wrong_origin_socket, frozenset({"403", "400"})),
    "WebSocket without origin": (_no_origin, frozenset({"403"})),
    "WebSocket without the token": (no_token, frozenset({"403"})),
    "another host": (_wrong_host, frozenset({"403", "400"})),
    "page asked by another origin": (_wrong_origin_page, frozenset({"403"})),
    "another method": (_other_method, frozenset({"405", "400"})),
    "path out of the folder": (_traversal, frozenset({"404", "400"})),
    "no HTTP": (_no_http, frozenset({"400", "cut off"})),
    "huge head": (_huge_head, frozenset({"400", "cut off"})),
    "two hosts": (_two_hosts, frozenset({"400", "403"})),
    "smuggled request": (_smuggled, frozenset({"400", "405"})),
    "no request": (_nonsense_text, frozenset({"notice", "closed 1009"})),
    "request out of place": (_out_of_place, frozenset({"notice"})),
    "binary message": (_binary, frozenset({"closed 1003"})),
    "huge message": (_huge_message, frozenset({"closed 1009", "cut off"})),
    "message said to be huge": (_claimed_huge, frozenset({"closed 1009", "cut off"})),
    "endless fragments": (_endless_fragments, frozenset({"cut off"})),
    "broken frames": (_broken_frames, frozenset({"closed 1002", "closed 1007", "cut off"})),
    "300 requests at once": (_flood, frozenset({"closed 1008", "cut off"})),
    "2000 pings": (_ping_flood, frozenset({"cut off"})),
    "half-open": (_half_open, frozenset({"left open"})),
}
"""What is tried, and how the console may answer: anything else was not refused."""


def attack(
    target: Target, requests: int, seed: int, pause: Callable[[], None] = lambda: None
) -> tuple[Counter[tuple[str, str]], list[str]]:
    """Send hostile requests of all kinds by turns.

    Returns:
        (kind, outcome) -> how often; and what was not refused.
    """
    source = random.Random(seed)
    outcomes: Counter[tuple[str, str]] = Counter()
    not_refused: list[str] = []
    kinds = list(ATTACKS.items())
    for number in range(requests):
        kind, (make, allowed) = kinds[number % len(kinds)]
        try:
            outcome = make(target, source)
        except TimeoutError:
            outcome = "no answer"
        except ConnectionError:
            outcome = "cut off"
            allowed = allowed | {"cut off"}
        outcomes[kind, outcome] += 1
        if outcome not in allowed:
            not_refused.append(f"{kind}: {outcome}")
        pause()
    return outcomes, not_refused


class Gaps:
    """The longest time between two of a thing."""

    def __init__(self) -> None:
        self.count = 0
        self.longest = 0.0
        self._last: float | None = None

    def begin(self) -> None:
        """Count from now on."""
        self.count, self.longest, self._last = 0, 0.0, None

    def note(self) -> None:
        now = time.monotonic()
        if self._last is not None:
            self.longest = max(self.longest, now - self._last)
        self._last = now
        self.count += 1


class Arena:
    """A game without end on a real bus, the console as a process, an observer, and an honest page.

    Args:
        host: what the console is bound to; other than 127.0.0.1 it wants a token.
    """

    def __init__(self, period: float = 0.1, host: str = "127.0.0.2", camera: Camera | None = None) -> None:
        self._closing = contextlib.ExitStack()
        self.folder = Path(self._closing.enter_context(tempfile.TemporaryDirectory(prefix="vh-")))
        self.folder.chmod(0o700)
        self.bus_ticks, self.page_ticks = Gaps(), Gaps()
        self.of_console: Counter[str] = Counter()
        self.episodes: set[tuple[int, str]] = set()
        self.reasons: list[str] = []
        self.lost: dict[str, int] = {}
        self.ways: list[float] = []  # s from `publish` to the observer's hand
        self._stop = threading.Event()
        rules = Rules(maximum_steps=100_000, catching=False, step_period=period)
        referee = RefereeSettings(
            autoplay=True, rules=rules, players=Players(hider="random"), required=("simulator", "seeker", "hider")
        )

        def drive(episode: Episode) -> RandomPrimitives:
            import numpy as np

            return RandomPrimitives(episode.rules.maximum_steps, np.random.default_rng(1))

        cores: dict[str, Core] = {
            "simulator": SimulatorCore(),
            "seeker": SeekerCore(),
            "hider": HiderCore(drive),
            "referee": RefereeCore(referee),
        }
        observer = self._closing.enter_context(ZenohBus("recorder", self.folder))
        observer.subscribe("**", raw=True)
        self._observing = threading.Thread(target=self._observe, args=(observer,), daemon=True)
        self._observing.start()
        self._closing.callback(self._end_observing)
        for name, core in cores.items():
            runtime = Runtime(core, self._closing.enter_context(ZenohBus(name, self.folder)))
            thread = threading.Thread(target=runtime.run, name=name, daemon=True)
            thread.start()
            self._closing.callback(thread.join, 5.0)
            self._closing.callback(runtime.stop)
        command = [sys.executable, "-m", "services.console", "--folder", str(self.folder), "--port", "0", "--host", host]
        self.log = self.folder / "console.log"
        self.console = subprocess.Popen(command, stderr=self.log.open("w"), cwd=Path(__file__).resolve().parents[1])
        self._closing.callback(self._end_console)
        address = self.folder / CONSOLE_ADDRESS
        self.wait(address.is_file, "the console gives no address")
        url, _, fragment = address.read_text().strip().partition("#")
        name, _, port = url.removeprefix("http://").rstrip("/").rpartition(":")
        self.target = Target(host if host != "0.0.0.0" else "127.0.0.1", int(port), fragment.removeprefix("token="))
        self.page = Socket(self.target)
        threading.Thread(target=self._watch, daemon=True).start()
        self.wait(lambda: self.page_ticks.count > 3, "no tick comes to the page")

    def wait(self, until: Callable[[], bool], complaint: str, seconds: float = 60.0) -> None:
        end = time.monotonic() + seconds
        while not until():
            if time.monotonic() > end or self.console.poll() is not None:
                raise RuntimeError(f"{complaint}: {self.log.read_text()[-2000:]}")
            time.sleep(0.02)

    def _observe(self, observer: ZenohBus) -> None:
        while not self._stop.is_set():
            event = observer.receive(0.1)
            if not isinstance(event, Sample):
                continue
            self.ways.append((time.time_ns() - event.published) / 1e9)
            if event.publisher == "console":
                self.of_console[event.key] += 1
            if event.key == "tick":
                self.bus_ticks.note()
            elif event.key == "episode" or event.key.startswith("health/"):
                said = event.decode()
                if isinstance(said, Episode):
                    self.episodes.add((said.episode, said.phase))
                elif isinstance(said, Health):
                    self.lost[said.service] = sum(each.lost for each in said.inputs)
                    if said.service == "console" and said.reason:
                        self.reasons.append(said.reason)

    def _watch(self) -> None:
        with contextlib.suppress(OSError):  # closed at the end
            for header in self.page.headers():
                if header["key"] == "tick":
                    self.page_ticks.note()

    def _end_observing(self) -> None:
        self._stop.set()
        self._observing.join(5.0)

    def _end_console(self) -> None:
        self.console.terminate()
        try:
            self.console.wait(5.0)
        except subprocess.TimeoutExpired:
            self.console.kill()
            self.console.wait()

    def __enter__(self) -> Arena:
        return self

    def __exit__(self, *_: object) -> None:
        for connection in self.target.held:
            connection.close()
        self.page.raw.close()
        self._closing.close()


@dataclass
class Settings:
    """How much is tried."""

    requests: int = 10_000
    seed: int = 1


def main(settings: Settings) -> int:
    with Arena() as arena:
        began = time.monotonic()
        told = 0

        def progress() -> None:
            nonlocal told
            told += 1
            if told % 500 == 0:
                print(f"\r{told} of {settings.requests}", end="", file=sys.stderr, flush=True)

        arena.bus_ticks.begin()
        arena.page_ticks.begin()
        outcomes, not_refused = attack(arena.target, settings.requests, settings.seed, progress)
        seconds = time.monotonic() - began
        print(file=sys.stderr)
        at_bus, at_page = arena.bus_ticks.count, arena.page_ticks.count
        arena.wait(lambda: arena.page_ticks.count > at_page + 3, "the page has stopped")
        print(f"{settings.requests} hostile requests in {seconds:.1f} s, {len(ATTACKS)} kinds")
        for (kind, outcome), count in sorted(outcomes.items()):
            print(f"  {kind:30} {outcome:14} {count}")
        print(f"not refused: {len(not_refused)}", *sorted(set(not_refused)), sep="\n  ")
        others = {key: count for key, count in arena.of_console.items() if key != "health/console"}
        print(f"messages of the console on the bus: health {arena.of_console['health/console']}, others {others or 'none'}")
        print(f"episodes: {sorted(arena.episodes)}")
        print(f"ticks during the attack: {at_bus} on the bus, {at_page} at the honest page; one is due every 0.1 s")
        longest = f"on the bus {arena.bus_ticks.longest * 1e3:.0f} ms, at the honest page {arena.page_ticks.longest * 1e3:.0f} ms"
        print(f"longest time between two ticks: {longest}")
        print(f"health said: {arena.reasons[-1] if arena.reasons else 'nothing'}")
        return int(bool(not_refused or others))


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
