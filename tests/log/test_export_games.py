"""Outlines say of a log what its whole games say, and steps come in order, whatever order publishers came in."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec import structs

from schemas import Control, Episode, Gap, Message, encode
from services.recorder.appearance import arena_appearance
from tests.log.exporting import discard, real_log, write
from tests.log.making import START, game, records_of
from vantage.log import Record, open_log, read
from vantage.log.episodes import games_of
from vantage.log.export_formats import export_to, file_names
from vantage.log.games import WORD_TOPICS, NoSuchGame, find_game
from vantage.log.games import games_of as heard
from vantage.log.outline import outline, steps_of
from vantage.log.report import info
from vantage.output import AlreadyExists
from vantage.replay.recording import Recording

KEYS = ("hider/pose", "seeker/pose", "hider/color", "seeker/depth", "hider/command", "hider/plan")


def again(records: list[Record], by: int) -> list[Record]:
    """The same game once more: number and seed are the same, only the moment is another."""
    said = [(record, record.decode()) for record in records]
    return [
        structs.replace(record, payload=encode(structs.replace(message, stamp=message.stamp + by))) for record, message in said
    ]


def damaged(seed: int) -> list[Record]:
    """Games, shuffled a little, with losses, aborted and discarded ones, numbers and seeds that come again, a late abort."""
    chance = random.Random(seed)
    records: list[Record] = []
    numbers = chance.choice(((1, 2, 3), (1, 2, 2), (1, 2, 1), (1, 1, 1), (1, 2, 3, 1)))
    for place, number in enumerate(numbers):
        begin = records[-1].log_time + 10_000_000 if records else START
        phase = chance.choice(("ended", "ended", "aborted", "setup"))
        game_seed = chance.choice((place, numbers.index(number)))
        played = records_of(game(number, chance.randint(1, 8), seed=game_seed, phase=phase), start=begin)
        records += again(played, place)
        if chance.random() < 0.3:
            # The referee was restarted: it calls the last game aborted, also one that had ended, and has another seed.
            word = Episode(stamp=records[-1].log_time, episode=number, seed=77, phase="aborted")
            records.append(Record("episode", "referee", 0, records[-1].log_time + 50_000_000, 0, encode(word)))
    if chance.random() < 0.5:
        # Not a set-up: without it, two games of one number are one, of which each step is there twice.
        records.pop(chance.choice([place for place, record in enumerate(records) if record.key != "episode"]))
    if chance.random() < 0.3:
        at = records[chance.randrange(len(records))]
        key = chance.choice(("hider/pose", "health/seeker"))
        records.append(Record("gap", "recorder", 0, at.log_time, 0, encode(Gap(stamp=1, key=key, publisher="x", missed=2))))
    if chance.random() < 0.3:
        records.append(Record("seeker/pose", "x", 0, records[chance.randrange(len(records))].log_time, 0, b"\xc1"))
    for _ in range(chance.choice((0, 0, 1, 2))):
        records.append(discard(chance.choice((1, 2, 3)), records[chance.randrange(len(records))]))
    return sorted(records, key=lambda record: record.log_time + chance.randint(0, 3_000_000))


@given(st.integers(0, 10**9))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_outlines_agree_with_whole_games(tmp_path: Path, seed: int) -> None:
    path = tmp_path / f"{seed}.mcap"
    if not path.exists():
        write(path, damaged(seed))
    with open_log(path) as log:
        whole, outlines = list(games_of(log)), outline(log)
        said = heard(log.records(WORD_TOPICS))
        (report,) = info(path)
        shown = [(g.episode, g.discarded) for g in said]
        for found in (whole, outlines, report.games):
            assert [(g.episode, g.discarded) for g in found] == shown
        assert [(g.steps, g.whole, g.complete, g.lost, g.malformed) for g in whole] == [
            (g.steps, g.whole, g.complete, g.lost, g.malformed) for g in outlines
        ]
        replayed = Recording(path)
        assert [(g.episode, g.discarded) for g in replayed.games] == shown  # all of them begin with a set-up
        replayed.close()
        assert [g.layout for g in whole] == [g.layout for g in outlines]
        by_name = {g.place: g for g in whole}
        seen: dict[int, list[int]] = {}
        for found, step, messages in steps_of(log, outlines, KEYS):
            name = found.game.place
            seen.setdefault(name, []).append(step)
            held = by_name[name]
            parts = {"pose": held.poses, "color": held.colors, "depth": held.depths, "command": held.commands}
            for key, message in messages.items():
                robot, _, part = key.partition("/")
                expected = held.plans if part == "plan" else parts[part][robot]  # type: ignore[index]
                assert expected[step] == message
            for key in KEYS:
                assert (key in messages) == found.has_step(key, step)
        for found in outlines:
            last = max((mask.bit_length() for mask in found.held.values()), default=0)
            steps = [step for step in range(last) if any(found.has_step(key, step) for key in KEYS)]
            assert seen.get(found.game.place, []) == steps


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


def aborted_again(number: int) -> tuple[str, Message]:
    return "episode", Episode(stamp=9, episode=number, seed=123, phase="aborted", reason="the referee was restarted")


def discarded(number: int) -> tuple[str, Message]:
    return "control", Control(stamp=9, episode=number, action="discard")


def test_a_game_is_discarded_also_after_the_referee_was_restarted(tmp_path: Path) -> None:
    """The restarted one calls the last game aborted, with a seed of its own."""
    messages = [*game(1, 3, seed=5), aborted_again(1), *game(2, 3, seed=123), *game(3, 3, seed=124), discarded(1)]
    write(tmp_path / "log.mcap", records_of(messages))
    expected = [(1, 5, "ended", True), (2, 123, "ended", False), (3, 124, "ended", False)]
    with open_log(tmp_path / "log.mcap") as log:
        for games in (list(games_of(log)), outline(log), info(tmp_path / "log.mcap")[0].games):
            assert [(g.episode.episode, g.episode.seed, g.episode.phase, g.discarded) for g in games] == expected
        # What the restarted referee says of an ended game is not part of it.
        assert outline(log)[0].last_time == records_of(messages)[len(list(game(1, 3))) - 1].log_time


def test_what_a_restarted_referee_does_not_know_is_kept(tmp_path: Path) -> None:
    messages = [*game(1, 3, seed=5, phase="running"), aborted_again(1)]
    write(tmp_path / "log.mcap", records_of(messages))
    with open_log(tmp_path / "log.mcap") as log:
        (found,) = games_of(log)
    assert (found.episode.phase, found.episode.seed) == ("aborted", 5)


def test_games_of_one_number_have_names_of_their_own_and_are_listed(tmp_path: Path) -> None:
    records: list[Record] = []
    for place, (number, seed) in enumerate(((1, 5), (2, 6), (1, 5), (2, 7))):
        records += again(records_of(game(number, 3, seed=seed), start=START + place * 10**9), place)
    write(tmp_path / "log.mcap", records)
    with open_log(tmp_path / "log.mcap") as log:
        games = outline(log)
        assert file_names(games) == ["game-0001-seed-5-1", "game-0002-seed-6", "game-0001-seed-5-2", "game-0002-seed-7"]
        with pytest.raises(NoSuchGame, match=r"2 games .* number 2:\n.*1\.0 s after the first game, seed 6\n.*3\.0 s .*seed 7"):
            find_game(games, 2)
        assert find_game(games[1:3], 2) is games[1]
    done = export_to("rerun", tmp_path / "log.mcap", tmp_path / "out", arena_appearance())
    assert sorted(path.stem for path in (tmp_path / "out").iterdir()) == sorted(file_names(games))
    assert len(done.said) == 4
    with pytest.raises(NoSuchGame):
        export_to("rerun", tmp_path / "log.mcap", tmp_path / "one", arena_appearance(), episode=1)


def test_a_name_that_is_taken_is_noticed_before_anything_is_written(tmp_path: Path) -> None:
    write(tmp_path / "log.mcap", [*records_of(game(1, 3)), *records_of(game(2, 3), start=START + 10**9)])
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "game-0002.rrd").write_text("mine")
    with pytest.raises(AlreadyExists):
        export_to("rerun", tmp_path / "log.mcap", tmp_path / "out", arena_appearance())
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["game-0002.rrd"]
