"""A stranger on the bus says nonsense on every key: no service dies of it, each counts it, and games go on afterwards.

`python -m tests.stack.test_absurd_messages 100000 10000` says that many on *each* key; the suite a tenth of them altogether.
"""

from __future__ import annotations

import json
import random
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import zenoh

from schemas import CALLS, TOPICS, InputHealth
from tests.stack.absurd import random_bytes, shaped
from tests.stack.table import PATIENCE, Table, follow, stop_games, wait, wish
from vantage.bus.zenoh_bus import ZenohBus
from vantage.bus.zenoh_session import configuration
from vantage.check import declaration_of
from vantage.match import Match
from vantage.watch import HealthWatch

KEYS = tuple(TOPICS)
UNDECLARED = "nobody/declared/this"
Counts = Mapping[tuple[str, str], int]


@contextmanager
def stranger(table: Table) -> Iterator[zenoh.Session]:
    """A raw Zenoh session on the deployment's sockets: no name, no stamps, none of our code."""
    config = zenoh.Config.from_json5(json.dumps(configuration("stranger", table.folder, frozenset(table.services()))))
    # It waits for slow readers, so that every message must be counted.
    config.insert_json5("transport/link/tx/queue/congestion_control/block/wait_before_close", "60000000")
    with zenoh.open(config) as session:
        yield session


def say(session: zenoh.Session, key: str, payloads: Iterator[bytes]) -> int:
    """Put every payload on a key once somebody listens there; return how many."""
    publisher = session.declare_publisher(f"vantage/table/{key}", congestion_control=zenoh.CongestionControl.BLOCK)
    wait(lambda: publisher.matching_status.matching, lambda: time.sleep(0.01), lambda: f"nobody listens to {key}")
    count = 0
    for payload in payloads:
        publisher.put(payload)
        count += 1
    publisher.undeclare()
    return count


def ask(session: zenoh.Session, payloads: Iterator[bytes]) -> int:
    """Ask the predictor each payload, a few at a time; return how many. Every question must get an answer or an error."""
    count = 0
    for payload in payloads:
        (_,) = session.get("vantage/table/predictor", payload=payload, timeout=PATIENCE)
        count += 1
    return count


def received(watch: HealthWatch) -> Counts:
    """(service, key) -> messages that the service got, could not decode or lost, since it started."""
    return reported(watch, lambda entry: entry.received + entry.malformed + entry.lost)


def reported(watch: HealthWatch, count: Callable[[InputHealth], int]) -> Counts:
    """(service, key) -> a count of what health says of that input."""
    return {
        (verdict.process.name, entry.key): count(entry)
        for verdict in watch.verdicts()
        if verdict.health
        for entry in verdict.health.inputs
    }


def barrage(table: Table, randoms: int, shapes: int, questions: int) -> float:
    """Say `randoms` random and `shapes` schema-shaped messages on every key while games run; return the seconds it took."""
    source = random.Random(7)
    pids = {process.name: process.pid for process in table.deployment.processes()}
    with ZenohBus("command-line", table.folder) as bus:
        match = Match(bus, wish(seed=3, games=1000, steps=200, period=0.05))
        follow(match, lambda: match.step >= 5, "a game runs")
    expected = [(name, key) for name in table.services() for key in (*KEYS, UNDECLARED) if hears_all(name, key)]
    with stranger(table) as session:
        wait_until_heard(table, session)
        with HealthWatch(table.deployment) as watch:
            table.wait_until_reported(watch)
            before = received(watch)
        started = time.monotonic()
        sent = {}
        for key in KEYS:
            kind = TOPICS[key].type
            sent[key] = say(session, key, (random_bytes(source) for _ in range(randoms)))
            sent[key] += say(session, key, (shaped(kind, source) for _ in range(shapes)))
        sent[UNDECLARED] = say(session, UNDECLARED, (random_bytes(source) for _ in range(randoms)))
        for key, call in CALLS.items():
            sent[key] = ask(session, (random_bytes(source) for _ in range(questions)))
            sent[key] += ask(session, (shaped(call.request, source) for _ in range(questions)))
    expected += [(name, key) for name in table.services() for key in declaration_of(name).serves]
    with HealthWatch(table.deployment) as watch:
        lacks = lambda: uncounted(before, received(watch), sent, expected)  # noqa: E731
        wait(lambda: not lacks(), lambda: watch.listen(0.2), lambda: f"not counted in health: {lacks()}")
    assert {process.name: process.pid for process in table.deployment.processes()} == pids, "a service died"
    return time.monotonic() - started


def wait_until_heard(table: Table, session: zenoh.Session) -> None:
    """Say nonsense until every service has heard some: the links of a new session come up one after another."""
    declarations = {name: declaration_of(name) for name in table.services()}
    pairs = [
        (name, UNDECLARED if declaration.raw else declaration.inputs[0])
        for name, declaration in declarations.items()
        if declaration.inputs
    ]
    with HealthWatch(table.deployment) as watch:
        table.wait_until_reported(watch)
        before = nonsense(watch)

        def deaf() -> list[tuple[str, str]]:
            return [pair for pair in pairs if nonsense(watch).get(pair, 0) <= before.get(pair, 0)]

        def say_more() -> None:
            for key in {key for _, key in deaf()}:
                session.put(f"vantage/table/{key}", b"nonsense", congestion_control=zenoh.CongestionControl.BLOCK)
            watch.listen(0.2)

        wait(lambda: not deaf(), say_more, lambda: f"do not hear the stranger: {deaf()}")


def nonsense(watch: HealthWatch) -> Counts:
    """(service, key) -> messages that no service sent: malformed ones, and on UNDECLARED, which a raw service hears, all."""
    return reported(watch, lambda entry: entry.malformed + (entry.received if entry.key == UNDECLARED else 0))


def hears_all(service: str, key: str) -> bool:
    """Whether a service gets every message of a key: of some topics a slow reader skips."""
    declaration = declaration_of(service)
    return declaration.raw or (key in declaration.inputs and TOPICS[key].delivery == "lossless")


def uncounted(before: Counts, after: Counts, sent: Mapping[str, int], expected: list[tuple[str, str]]) -> dict[str, int]:
    """What of the sent messages health does not show yet."""
    lacks = {
        f"{service} {key}": lack
        for service, key in expected
        if (lack := sent[key] - (after.get((service, key), 0) - before.get((service, key), 0))) > 0
    }
    return lacks


def test_no_service_dies_of_nonsense_and_all_is_counted(table: Table) -> None:
    assert table.started.returncode == 0, table.started.stderr
    barrage(table, randoms=10_000 // len(KEYS), shapes=5_000 // len(KEYS), questions=50)


def test_games_go_on_afterwards(table: Table) -> None:
    stop_games(table.folder)
    with HealthWatch(table.deployment) as watch:
        table.wait_until_healthy(watch)
    outcome = table.command("play", "--seed", "5", "--period", "0", "--steps", "10")
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


if __name__ == "__main__":
    with Table() as running:
        seconds = barrage(running, int(sys.argv[1]), int(sys.argv[2]), questions=1000)
        print(f"{len(KEYS)} keys, {sys.argv[1]} random and {sys.argv[2]} shaped messages each: no service died, {seconds:.0f} s")
        test_games_go_on_afterwards(running)
