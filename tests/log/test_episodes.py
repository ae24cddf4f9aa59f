"""Grouping a log into games."""

from __future__ import annotations

import random
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from rich.console import Console

from schemas import Control, Episode, Gap, Message, Players, Pose, encode
from tests.log.making import START, game, records_of, write_log
from vantage.log import Record, open_log, read
from vantage.log.episodes import EPISODE_TOPICS, EpisodeLog, episodes, games_of
from vantage.log.report import info


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


def test_a_loss_counts_against_all_games_under_way_and_after_them_against_the_last() -> None:
    gap = Record("gap", "recorder", 0, START, 0, encode(Gap(stamp=1, key="hider/pose", publisher="x", missed=2)))
    broken = Record("hider/pose", "x", 0, START, 0, b"\xc1", False)
    first, second = played(1, 3), played(2, 3)
    both = episodes([*first[:-1], second[0], gap, broken, first[-1], *second[1:]])
    assert [(log.number, log.lost, log.malformed) for log in both] == [(1, 2, 1), (2, 2, 1)]
    over = episodes([*first, *second, gap, broken])
    assert [(log.number, log.lost, log.malformed) for log in over] == [(1, 0, 0), (2, 2, 1)]
    assert not list(episodes([gap, broken])), "of no game"


def test_messages_outside_any_game_belong_to_none() -> None:
    stray = Record("hider/pose", "x", 0, START, 0, encode(Pose(stamp=1, x=0.0, y=0.0, heading=0.0)))
    assert list(episodes([stray])) == []


def control(action: str, number: int = 0) -> tuple[str, Message]:
    return "control", Control(stamp=1, episode=number, action=action)  # type: ignore[arg-type]


def logged(path: Path, messages: Iterable[tuple[str, Message]]) -> list[EpisodeLog]:
    write_log(path, records_of(list(messages)))
    with open_log(path) as log:
        return list(games_of(log))


@pytest.mark.parametrize("after", [1, 2, 3, 6])
def test_a_discarded_game_is_no_data_however_much_later_it_is_discarded(tmp_path: Path, after: int) -> None:
    messages = [
        message for number in range(1, 7) for message in [*game(number, 3), *([control("discard", 1)] * (number == after))]
    ]
    found = logged(tmp_path / "log.mcap", messages)
    assert [(log.discarded, log.complete, log.whole) for log in found] == [(True, False, True), *[(False, True, True)] * 5]


def test_other_wishes_discard_nothing() -> None:
    messages = list(game(1, 3))
    for action in ("pause", "resume", "stop", "start", "seek"):
        (found,) = episodes(records_of([*messages, control(action, 1)]))
        assert found.complete and not found.discarded
    (found,) = episodes(records_of([*messages, control("discard", 2), control("discard")]))
    assert found.complete


def test_the_newest_game_of_a_number_is_meant(tmp_path: Path) -> None:
    messages = [*game(1, 3, seed=5), *game(1, 3, seed=6), control("discard", 1)]
    assert [(log.episode.seed, log.discarded) for log in logged(tmp_path / "log.mcap", messages)] == [(5, False), (6, True)]
    messages = [*game(1, 3, seed=5), control("discard", 1), *game(1, 3, seed=6)]
    assert [(log.episode.seed, log.discarded) for log in logged(tmp_path / "other.mcap", messages)] == [(5, True), (6, False)]


@given(st.lists(st.tuples(st.integers(0, 8), st.integers(0, 9)), max_size=6))
def test_discards_anywhere_are_those_that_were_asked_for(
    tmp_path_factory: pytest.TempPathFactory, wishes: list[tuple[int, int]]
) -> None:
    """Brute force: a wish counts for a game that was set up before it."""
    messages: list[tuple[str, Message]] = []
    for number in range(1, 8):
        messages += game(number, 1)
        messages += [control("discard", which) for after, which in wishes if after == number]
    expected = {which for after, which in wishes if 1 <= which <= after <= 7}
    found = logged(tmp_path_factory.mktemp("discards") / "log.mcap", messages)
    assert {log.number for log in found if log.discarded} == expected
    assert [log.number for log in found] == list(range(1, 8))


def test_a_paused_game_is_one_game() -> None:
    messages = list(game(1, 6))
    running = next(message for key, message in messages if isinstance(message, Episode) and message.phase == "running")
    middle = len(messages) // 2
    pause = [("episode", structs.replace(running, paused=True, step=3)), control("pause")]
    resume = [control("resume"), ("episode", structs.replace(running, step=3))]
    (found,) = episodes(records_of([*messages[:middle], *pause, *resume, *messages[middle:]]))
    (expected,) = episodes(records_of(messages))
    assert found.complete and (found.poses, found.commands, found.episode) == (
        expected.poses,
        expected.commands,
        expected.episode,
    )
    (broken_off,) = episodes(records_of([*messages[:middle], *pause]))
    assert (broken_off.episode.phase, broken_off.episode.paused, broken_off.complete) == ("running", True, False)


def test_info_says_who_drove_and_what_was_discarded(tmp_path: Path) -> None:
    def driven(number: int, hider: str, person: str) -> list[tuple[str, Message]]:
        players = Players(hider=hider, person=person)
        return [
            (key, structs.replace(message, players=players) if isinstance(message, Episode) else message)
            for key, message in game(number, 2)
        ]

    messages = [*driven(1, "human", "Ada"), *driven(2, "human", ""), *driven(3, "planner", ""), control("discard", 2)]
    write_log(tmp_path / "log.mcap", records_of(messages))
    (report,) = info(tmp_path / "log.mcap")
    assert [(game.driver, game.phase) for game in report.games] == [
        ("human (Ada)", "ended"),
        ("human", "ended, discarded"),
        ("planner", "ended"),
    ]
    console = Console(width=200, record=True, file=(tmp_path / "out").open("w"))
    console.print(report)
    assert "human (Ada)" in console.export_text()
