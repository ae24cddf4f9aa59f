"""Which games are still to come, and what of that pages are told: Stop, Pause and Go on are offered by it."""

from __future__ import annotations

from typing import Any

import pytest

from schemas import Control, Episode, Players
from services.console.frames import frame_of
from services.console.session import Session
from tests.services.console_game import parse


def control(action: str, **more: Any) -> Control:
    return Control(stamp=1, action=action, **more)  # type: ignore[arg-type]


def game(number: int, phase: str, **more: Any) -> Episode:
    return Episode(stamp=1, episode=number, seed=number, phase=phase, **more)  # type: ignore[arg-type]


def told(session: Session) -> dict[str, Any]:
    header, _ = parse(session.frame(0))
    return header


def play(session: Session, number: int, **more: Any) -> None:
    for phase in ("setup", "running"):
        session.see(game(number, phase), False)
    session.see(game(number, "ended", outcome="survived", **more), False)


@pytest.mark.parametrize("wanted", [1, 3])
def test_more_games_come_until_the_last_one_began(wanted: int) -> None:
    session = Session()
    assert told(session)["more_games"] is False
    session.hear(control("start", games=wanted))
    assert told(session)["more_games"] is True
    for number in range(1, wanted + 1):
        session.see(game(number, "setup"), False)
        assert told(session)["more_games"] is (number < wanted)
        session.see(game(number, "ended", outcome="caught", caught_step=1), False)
        assert told(session)["more_games"] is (number < wanted)


def test_games_without_end_come_until_they_are_stopped() -> None:
    session = Session()
    session.hear(control("start", games=0))
    for number in range(1, 5):
        play(session, number)
        assert told(session)["more_games"] is True
    session.hear(control("stop"))
    assert told(session)["more_games"] is False


def test_a_game_that_gives_way_is_not_the_first_of_the_next_ones() -> None:
    session = Session()
    session.hear(control("start", games=1))
    session.see(game(4, "running"), False)
    session.hear(control("start", games=2))
    session.see(game(4, "aborted"), False)
    assert told(session)["more_games"] is True
    play(session, 5)
    assert told(session)["more_games"] is True
    play(session, 6)
    assert told(session)["more_games"] is False


def test_a_pause_that_outlives_its_game_says_that_another_one_waits() -> None:
    """Also to a console that never heard `start`: it came later, or the referee plays by itself."""
    session = Session()
    play(session, 2, paused=True)
    assert (told(session)["paused"], told(session)["more_games"]) == (True, True)
    session.hear(control("resume"))
    assert told(session)["paused"] is False
    session.see(game(3, "setup"), False)
    assert (told(session)["paused"], told(session)["more_games"]) == (False, False)


def test_a_pause_between_games_can_be_taken_back() -> None:
    session = Session()
    session.hear(control("start", games=2))
    play(session, 1)
    session.hear(control("pause"))
    assert told(session)["paused"] is True
    session.hear(control("resume"))
    assert told(session)["paused"] is False


def test_nobody_is_told_who_plays() -> None:
    players = Players(hider="human", person="Ada Lovelace")
    session = Session()
    session.hear(control("start", players=players))
    session.see(game(1, "setup", players=players), False)
    header, _ = parse(frame_of("episode", game(1, "setup", players=players)))
    assert header["players"] == {"hider": "human", "seeker": "glancing"}
    assert "Lovelace" not in str(session.frame(0))
