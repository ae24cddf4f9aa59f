"""Ten thousand hostile requests against a console on a real bus while a game runs.

    python benchmarks/console_hostile.py                     the whole of it
    python benchmarks/console_hostile.py --requests 500

Wrong origins and hosts, no token, other methods, paths out of the folder, nonsense instead of HTTP, of WebSocket, of JSON, of
requests; huge, endless, far too many, far too slow, never read. Referee, simulator, seeker and a hider play on a Zenoh bus; the
console is the real process. An honest page is open all the while. Said at the end: what was sent and how it was refused, what
the console published, the longest time between two ticks on the bus and at the honest page.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import tyro

from tests.services.console_arena import Arena
from tests.services.console_attacks import ATTACKS, attack


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
