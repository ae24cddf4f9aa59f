"""Grouping a log into games."""

from __future__ import annotations

import random
from pathlib import Path

from msgspec import structs

from schemas import Episode, Gap, Pose, encode
from tests.log.making import START, game, records_of, write_log
from vantage.log import Record, read
from vantage.log.episodes import EPISODE_TOPICS, EpisodeLog, episodes


def played(number: int, steps: int, **options: object) -> list[Record]:
    return records_of(game(number, steps, **options), start=START + number * 10**9)  # type: ignore[arg-type]


def test_everything_of_a_game_by_robot_and_step() -> None:
    messages = list(game(7, 12, seed=99))
    (found,) = episodes(records_of(messages))
    assert (found.number, found.steps, found.episode.seed, found.episode.outcome, found.complete) == (7, 12, 99, "survived", True)
    assert found.layout is not None
    for key, message in messages:
        robot, _, part = key.partition("/")
        if part in ("pose", "depth", "color", "command"):
            held = {"pose": found.poses, "depth": found.depths, "color": found.colors, "command": found.commands}[part]
            assert held[robot][message.step] == message  # type: ignore[index]
    assert list(found.poses["hider"]) == list(range(13))
    assert list(found.commands["seeker"]) == list(range(12))
    assert list(found.plans) == [0]
    assert [tick.step for tick in found.ticks] == list(range(12))


def test_games_come_in_order_from_a_file(tmp_path: Path) -> None:
    records = [record for number in (1, 2, 3) for record in played(number, 5)]
    write_log(tmp_path / "log.mcap", records)
    found = list(episodes(read(tmp_path / "log.mcap", topics=EPISODE_TOPICS)))
    assert [(log.number, log.steps, log.complete) for log in found] == [(1, 5, True), (2, 5, True), (3, 5, True)]


def test_publishers_are_not_ordered_among_each_other() -> None:
    first, second = played(1, 8), played(2, 8)
    shuffled = sorted(first + second, key=lambda record: record.log_time + random.Random(record.log_time).randint(0, 20_000_000))
    plain = {log.number: log for log in episodes(first + second)}
    mixed = {log.number: log for log in episodes(shuffled)}
    assert mixed.keys() == plain.keys()
    for number, log in mixed.items():
        assert log.poses == plain[number].poses
        assert log.commands == plain[number].commands
        assert log.layout == plain[number].layout


def test_what_comes_before_and_after_the_referee_speaks_belongs_to_the_game() -> None:
    records = played(1, 4)
    setup = records.pop(0)
    ended = next(i for i, record in enumerate(records) if _phase(record) == "ended")
    late = records.pop(ended)
    (found,) = episodes([*records[:6], setup, *records[6:-3], late, *records[-3:]])
    (expected,) = episodes(played(1, 4))
    assert (found.poses, found.depths, found.layout) == (expected.poses, expected.depths, expected.layout)
    assert found.complete


def _phase(record: Record) -> str:
    message = record.decode()
    return message.phase if isinstance(message, Episode) else ""


def test_the_same_number_with_another_seed_is_another_game() -> None:
    first, second = played(1, 3, seed=5), played(1, 6, seed=6)
    found = list(episodes(first + second))
    assert [(log.episode.seed, log.steps, log.complete) for log in found] == [(5, 3, True), (6, 6, True)]


def test_a_log_that_begins_or_ends_within_a_game() -> None:
    records = played(1, 10)
    (found,) = episodes(records[: len(records) // 2])
    assert not found.complete
    assert found.episode.phase == "running"
    (tail,) = episodes(records[len(records) // 2 :])
    assert tail.episode.phase == "ended"
    assert not tail.complete


def test_aborted_games_and_losses_are_not_complete() -> None:
    (aborted,) = episodes(played(1, 4, phase="aborted"))
    assert not aborted.complete
    records = played(1, 4)
    gap = Record("gap", "recorder", 0, records[9].log_time, 0, encode(Gap(stamp=1, key="hider/pose", publisher="x", missed=2)))
    other = Record("gap", "recorder", 0, records[9].log_time, 0, encode(Gap(stamp=1, key="health/x", publisher="x", missed=2)))
    broken = Record("hider/pose", "x", 0, records[9].log_time, 0, b"\xc1", False)
    assert _with(records, gap).lost == 2
    assert not _with(records, gap).complete
    assert _with(records, other).complete
    assert _with(records, broken).malformed == 1
    assert not _with(records, broken).complete
    missing = [record for record in records if not (record.key == "seeker/depth" and record.sequence == 2)]
    assert not next(iter(episodes(missing))).complete


def _with(records: list[Record], extra: Record) -> EpisodeLog:
    (found,) = episodes([*records[:10], extra, *records[10:]])
    return found


def test_a_game_that_has_ended_is_not_aborted_any_more() -> None:
    ended = list(game(3, 4))
    _, last = ended[-1]
    assert isinstance(last, Episode)
    (found,) = episodes(records_of([*ended, ("episode", structs.replace(last, phase="aborted", outcome="undecided"))]))
    assert found.complete and found.episode.outcome == "survived"


def test_losses_after_a_game_do_not_count_against_the_one_before() -> None:
    gap = Record("gap", "recorder", 0, START, 0, encode(Gap(stamp=1, key="hider/pose", publisher="x", missed=2)))
    second = played(2, 3)
    found = list(episodes([*played(1, 3), second[0], gap, *second[1:]]))
    assert [log.lost for log in found] == [0, 2]


def test_messages_outside_any_game_belong_to_none() -> None:
    stray = Record("hider/pose", "x", 0, START, 0, encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0)))
    assert list(episodes([stray])) == []
