"""Somebody plays the hider: by keyboard to the end, with a name or without, paused, reloaded, taken back; and sees no more."""

from __future__ import annotations

import warnings
from collections.abc import Callable

from tests.console.browser import ConsolePage, wait_until
from tests.stack.table import Table
from vantage.log import read
from vantage.log.episodes import EpisodeLog, episodes
from vantage.log.reader import BrokenLog

BETWEEN = "['between', 'done'].includes(vantage.state.play?.phase)"
STEP = "vantage.state.frames.tick?.header.step"


def number_of(page: ConsolePage) -> int:
    return int(page.get("vantage.state.frames.episode.header.episode"))


def game_in_log(table: Table, number: int, so: Callable[[EpisodeLog], bool]) -> EpisodeLog:
    """Return a game of the table's log once the recorder has flushed it."""
    found: list[EpisodeLog] = []

    def look() -> bool:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BrokenLog)  # it is being written
            found[:] = [game for game in episodes(read(table.logs)) if game.number == number and so(game)]
        return bool(found)

    wait_until(look, 15, f"episode {number} in the log")
    return found[0]


def play_to_the_end(page: ConsolePage) -> None:
    page.page.keyboard.down("ArrowLeft")
    page.until(f"{STEP} >= 5 || {BETWEEN}")
    page.page.keyboard.up("ArrowLeft")
    page.page.keyboard.down("w")
    page.until(BETWEEN, timeout=30)
    page.page.keyboard.up("w")


def test_a_game_is_played_by_keyboard_to_its_end_and_the_log_says_human(page: ConsolePage, table: Table) -> None:
    page.begin_human_game(steps=20)
    number = number_of(page)
    play_to_the_end(page)
    shown = page.text(".outcome")
    game = game_in_log(table, number, lambda game: game.episode.phase == "ended")
    assert game.episode.players.hider == "human"
    assert game.episode.players.person == "", "no name without the tick"
    assert game.episode.outcome in shown.lower()
    assert game.whole
    driven = [command.primitive for _, command in sorted(game.commands["hider"].items())]
    assert driven.count("left") >= 3
    assert driven.count("forward") >= 3
    assert driven.index("left") < driven.index("forward")
    assert sorted(game.views["hider"]) == list(range(game.steps)) or len(game.views["hider"]) >= game.steps


def test_a_name_is_stored_only_with_consent_and_known_the_next_time(page: ConsolePage, table: Table) -> None:
    page.begin_human_game(steps=8, name="Ada")
    number = number_of(page)
    play_to_the_end(page)
    game = game_in_log(table, number, lambda game: game.episode.phase == "ended")
    assert game.episode.players.person == "Ada"
    page.press("Enter")  # another session
    assert page.page.get_by_label("name or pseudonym").input_value() == "Ada"


def test_a_player_sees_nothing_but_the_hiders_eyes(page: ConsolePage) -> None:
    page.press("g")
    page.until("vantage.state.frames['seeker/pose'] && vantage.state.frames.layout")
    page.begin_human_game(steps=200)
    page.until(f"{STEP} >= 3 && vantage.state.frames['hider/color'] || {BETWEEN}")
    held = set(page.get("Object.keys(vantage.state.frames)"))
    assert held <= {
        "welcome",
        "episode",
        "tick",
        "services",
        "recording",
        "score",
        "session",
        "notice",
        "hider/color",
        "hider/view",
    }
    assert page.get("vantage.state.paths.seeker.length + vantage.state.past.size") == 0
    for hidden in (".stage", ".panel", ".prediction", ".health", ".legend"):
        assert page.page.locator(hidden).count() == 0
    assert page.page.locator("canvas:visible").count() == 1, "only the hider's colour picture"
    page.press("i")
    assert page.page.locator("canvas:visible").count() == 2, "and its state image, if wished"


def test_a_pause_holds_the_steps_and_a_reload_gives_the_wheel_back(page: ConsolePage) -> None:
    page.begin_human_game(steps=400, seed=11)
    page.until(f"{STEP} >= 2")
    page.press(" ")
    page.until("vantage.state.frames.episode.header.paused")
    assert "Paused" in page.text(".card")
    page.press("p")
    page.until("!vantage.state.frames.episode.header.paused")
    number = number_of(page)
    page.page.reload()
    page.until("vantage.state.frames.episode?.header.paused || " + BETWEEN)
    assert number_of(page) == number
    assert page.get("vantage.state.mode") == "play"
    step = page.get(STEP)
    page.press(" ")
    page.until("!vantage.state.frames.episode.header.paused")
    page.until(f"{STEP} > {step} || {BETWEEN}")
    assert page.get("vantage.state.frames.session.header.driver === vantage.state.frames.welcome.header.client")


def test_a_session_goes_on_and_the_last_game_can_be_taken_back(page: ConsolePage, table: Table) -> None:
    page.begin_human_game(games=2, steps=5)
    first = number_of(page)
    play_to_the_end(page)
    assert "1 of 2 games" in page.text(".outcome")
    page.press("Backspace")
    page.until("document.querySelector('.outcome').innerText.includes('0 of 2 games')")
    game_in_log(table, first, lambda game: game.discarded)
    page.press("Enter")
    page.wait_for_game()
    assert number_of(page) != first
    play_to_the_end(page)
    assert not game_in_log(table, number_of(page), lambda game: game.episode.phase == "ended").discarded
    assert "1 of 2 games" in page.text(".outcome")
