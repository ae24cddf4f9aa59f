"""Outlines say of a log what its whole games say, and steps come in order, whatever order publishers came in."""

from __future__ import annotations

import random
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from schemas import Gap, encode
from tests.log.exporting import discard, real_log, write
from tests.log.making import START, game, records_of
from vantage.log import Record, open_log, read
from vantage.log.episodes import games_of
from vantage.log.games import outline, steps_of

KEYS = ("hider/pose", "seeker/pose", "hider/color", "seeker/depth", "hider/command", "hider/plan")


def damaged(seed: int) -> list[Record]:
    """Three games, shuffled a little, with losses, an aborted game, a discarded one and one set up anew."""
    chance = random.Random(seed)
    records: list[Record] = []
    for number, phase in ((1, "ended"), (2, chance.choice(("ended", "aborted", "setup"))), (chance.choice((2, 3)), "ended")):
        begin = records[-1].log_time + 10_000_000 if records else START
        records += records_of(game(number, chance.randint(1, 8), seed=len(records), phase=phase), start=begin)
    if chance.random() < 0.5:
        # Not a set-up: without it, two games of one number are one, of which each step is there twice.
        records.pop(chance.choice([place for place, record in enumerate(records) if record.key != "episode"]))
    if chance.random() < 0.3:
        at = records[chance.randrange(len(records))]
        key = chance.choice(("hider/pose", "health/seeker"))
        records.append(Record("gap", "recorder", 0, at.log_time, 0, encode(Gap(stamp=1, key=key, publisher="x", missed=2))))
    if chance.random() < 0.3:
        records.append(Record("seeker/pose", "x", 0, records[chance.randrange(len(records))].log_time, 0, b"\xc1"))
    if chance.random() < 0.4:
        records.append(discard(chance.choice((1, 2, 3)), records[-1]))
    return sorted(records, key=lambda record: record.log_time + chance.randint(0, 3_000_000))


@given(st.integers(0, 10**9))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_outlines_agree_with_whole_games(tmp_path: Path, seed: int) -> None:
    path = tmp_path / f"{seed}.mcap"
    if not path.exists():
        write(path, damaged(seed))
    with open_log(path) as log:
        whole, outlines = list(games_of(log)), outline(log)
        assert sorted((g.number, g.episode.seed, g.steps, g.complete, g.discarded, g.episode.phase) for g in whole) == sorted(
            (g.number, g.episode.seed, g.steps, g.complete, g.discarded, g.episode.phase) for g in outlines
        )
        by_name = {(g.number, g.episode.seed): g for g in whole}
        seen: dict[tuple[int, int], list[int]] = {}
        for found, step, messages in steps_of(log, outlines, KEYS):
            name = (found.number, found.episode.seed)
            seen.setdefault(name, []).append(step)
            held = by_name[name]
            parts = {"pose": held.poses, "color": held.colors, "depth": held.depths, "command": held.commands}
            for key, message in messages.items():
                robot, _, part = key.partition("/")
                expected = held.plans if part == "plan" else parts[part][robot]  # type: ignore[index]
                assert expected[step] == message
            for key in KEYS:
                assert (key in messages) == found.has_step(key, step)
        for steps in seen.values():
            assert steps == sorted(set(steps))


def test_only_a_few_steps_wait_in_memory() -> None:
    """Steps are handed out while the log is read, not at the end of a game."""
    with open_log(real_log()) as log:
        games = outline(log)
        reader = steps_of(log, games, ("hider/color", "seeker/color"))
        consumed = 0

        def counting(*arguments: object, **options: object):  # type: ignore[no-untyped-def]
            nonlocal consumed
            for record in original(*arguments, **options):  # type: ignore[arg-type]
                consumed += 1
                yield record

        original = log.records
        log.records = counting  # type: ignore[method-assign]
        held = [consumed - 2 * (number + 1) for number, _ in enumerate(reader)]
        assert len(held) == sum(game.steps + 1 for game in games)
        assert max(held) <= 2


def test_a_log_without_games_has_none(tmp_path: Path) -> None:
    write(tmp_path / "empty.mcap", [])
    with open_log(tmp_path / "empty.mcap") as log:
        assert outline(log) == []
    assert list(read(tmp_path / "empty.mcap")) == []
