"""Somebody plays the hider: by keyboard to the end, with a name or without, paused, reloaded, taken back; and sees no more."""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Callable

from playwright.sync_api import Dialog

from tests.console.browser import ConsolePage, wait_until
from tests.stack.table import Table
from vantage.log import read
from vantage.log.episodes import EpisodeLog, episodes
from vantage.log.reader import BrokenLog

BETWEEN = "['between', 'done'].includes(vantage.state.play?.phase)"
BACKSPACE = "document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'Backspace', bubbles: true }))"
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

    wait_until(look, f"episode {number} in the log")
    return found[0]


def play_to_the_end(page: ConsolePage) -> None:
    """Turn left for some steps (the key is held already where it counts from the first one on), then drive on to the end."""
    page.page.keyboard.down("ArrowLeft")
    page.until(f"{STEP} >= 5 || {BETWEEN}")
    page.page.keyboard.up("ArrowLeft")
    page.page.keyboard.down("w")
    page.until(BETWEEN)
    page.page.keyboard.up("w")


def test_a_game_is_played_by_keyboard_to_its_end_and_the_log_says_human(page: ConsolePage, table: Table) -> None:
    page.begin_human_game(steps=100, key="ArrowLeft")
    number = number_of(page)
    play_to_the_end(page)
    shown = page.text(".outcome")
    game = game_in_log(table, number, lambda game: game.whole)
    assert game.episode.players.hider == "human"
    assert game.episode.players.person == "", "no name without the tick"
    assert game.episode.outcome in shown.lower()
    driven = [command.primitive for _, command in sorted(game.commands["hider"].items())]
    assert driven.count("left") >= 3
    assert driven.count("forward") >= 3
    assert driven.index("left") < driven.index("forward")
    assert sorted(game.views["hider"]) == list(range(game.steps)) or len(game.views["hider"]) >= game.steps


def test_a_name_is_stored_only_with_consent_and_known_the_next_time(page: ConsolePage, table: Table) -> None:
    page.begin_human_game(steps=8, name="Ada")
    number = number_of(page)
    play_to_the_end(page)
    game = game_in_log(table, number, lambda game: game.whole)
    assert game.episode.players.person == "Ada"
    page.press("Enter")  # another session
    assert page.page.get_by_label("name or pseudonym").input_value() == "Ada"
    assert not page.page.get_by_label("store it with the recording").is_checked(), "the next person may be another"


def test_a_player_sees_nothing_but_the_hiders_eyes(page: ConsolePage) -> None:
    page.watch_a_game("vantage.state.frames['seeker/pose'] && vantage.state.frames.layout", held=False)
    page.press("h", "Escape")
    page.until("vantage.state.mode === 'watch'")  # without a question: it is not this page's game
    page.hold_human_game(f"{STEP} >= 3 && vantage.state.frames['hider/color'] && vantage.state.frames['hider/view']", steps=200)
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
    questions: list[str] = []

    def stay(dialog: Dialog) -> None:
        questions.append(dialog.message)
        dialog.dismiss()

    page.page.once("dialog", stay)
    page.page.get_by_role("button", name="End session").click()
    assert page.get("vantage.state.mode") == "play"
    assert questions, "a game is not ended by one click"


def test_what_was_watched_is_forgotten_before_somebody_plays(page: ConsolePage) -> None:
    page.watch_a_game("vantage.state.paths.seeker.length > 2 && vantage.state.past.size > 2", held=False)
    page.press("h")
    page.until("vantage.state.mode === 'play'")
    assert page.get("vantage.state.paths.seeker.length + vantage.state.paths.hider.length + vantage.state.past.size") == 0
    assert not [key for key in page.get("Object.keys(vantage.state.frames)") if "seeker" in key or "plan" in key]


def test_a_pause_holds_the_steps_and_a_reload_gives_the_wheel_back(page: ConsolePage) -> None:
    # A step takes a second: the seeker does not come near while this looks.
    page.hold_human_game(f"{STEP} >= 1", steps=400, seed=11, period=1.0)
    page.page.get_by_role("button", name="State image").click()
    assert "Paused" in page.text(".card")
    page.press("p")
    page.until("!vantage.state.frames.episode.header.paused")
    page.page.get_by_role("button", name="forward").click()
    number = number_of(page)
    page.page.reload()
    page.until(f"(vantage.state.frames.episode?.header.paused || {BETWEEN}) && {STEP} !== undefined")
    assert number_of(page) == number
    assert page.get("vantage.state.mode") == "play"
    step = page.get(STEP)
    page.press(" ")
    page.until("!vantage.state.frames.episode.header.paused")
    page.until(f"{STEP} > {step} || {BETWEEN}")
    assert page.get(f"vantage.state.frames.session.header.driver === vantage.state.frames.welcome.header.client || {BETWEEN}")


def test_a_session_goes_on_and_the_last_game_can_be_taken_back(page: ConsolePage, table: Table) -> None:
    page.begin_human_game(games=2, steps=5)
    first = number_of(page)
    play_to_the_end(page)
    page.be_painted()
    assert "1 of 2 games" in page.text(".outcome")
    assert page.text(".play-facts").endswith("1 of 2")
    ahead = page.get(f"({BACKSPACE}, vantage.state.play.games.at(-1).discarded)")
    assert not ahead, "not before the console says so"
    page.until("document.querySelector('.outcome').innerText.includes('0 of 2 games')")
    page.be_painted()
    assert page.text(".play-facts").endswith("1 of 2"), "it is the first that is played again"
    game_in_log(table, first, lambda game: game.discarded)
    seed = page.get("vantage.state.frames.episode.header.seed")
    page.press("Enter")
    page.page.keyboard.down("ArrowLeft")  # held through the count-down: it counts
    page.wait_for_game()
    assert number_of(page) != first
    assert page.get("vantage.state.frames.episode.header.seed") == seed, "the same game is played again"
    page.until(BETWEEN)
    page.page.keyboard.up("ArrowLeft")
    again = game_in_log(table, number_of(page), lambda game: game.whole)
    assert not again.discarded
    driven = [command.primitive for _, command in sorted(again.commands["hider"].items())]
    assert driven.count("left") >= len(driven) - 1 > 1
    assert "1 of 2 games" in page.text(".outcome")


def test_a_second_person_neither_takes_nor_ends_the_game(page: ConsolePage, open_page: Callable[..., ConsolePage]) -> None:
    other = open_page()
    # A step takes a second: the seeker does not come near while this looks.
    page.ask_for_human_game(steps=300, seed=11, period=1.0)
    other.ask_for_human_game(steps=300, seed=12, period=1.0)
    pairs = ((page, other), (other, page))
    playing = "vantage.state.play.phase === 'game' && vantage.state.frames.episode.header.phase === 'running'"
    refused = "vantage.state.play.phase === 'between'"
    # Both count down at once; whichever page asks first plays.
    wait_until(lambda: any(page.get(playing) and other.get(refused) for page, other in pairs), "one plays, the other is refused")
    (page, other), seed = next((pair, seed) for pair, seed in zip(pairs, (11, 12), strict=True) if pair[0].get(playing))
    assert "somebody is playing at another page" in other.text(".outcome")
    other.until("document.querySelector('.outcome button.primary').disabled")
    other.press("Enter")
    assert other.get("vantage.state.play.phase") == "between"
    other.press("Escape", "h", "Enter")
    assert other.get("vantage.state.mode") == "play"
    other.until("document.querySelector('.ask button.primary')?.disabled")
    other.press("Enter")
    step = page.get(STEP) or 0
    page.until(f"{STEP} > {step} + 2")
    assert page.get("vantage.state.frames.episode.header.seed") == seed
    assert page.get("vantage.state.frames.episode.header.phase") != "aborted"
    page.idle()


def test_a_start_that_nobody_answers_is_taken_back(page: ConsolePage, table: Table) -> None:
    frozen = [table.pid_of(service) for service in ("referee", "recorder")]
    for pid in frozen:
        os.kill(pid, signal.SIGSTOP)
    try:
        page.ask_for_human_game()
        page.until("vantage.state.play.phase === 'between'")
        assert "the referee is silent" in page.text(".outcome")
        page.until("document.querySelector('.aside').innerText.includes('nothing heard of the recorder')")
    finally:
        for pid in frozen:
            os.kill(pid, signal.SIGCONT)
    page.press("Escape")
    ok = "vantage.state.frames.services?.header.services.find((each) => each.service === 'referee').state === 'ok'"
    page.until(f"vantage.state.mode === 'watch' && vantage.state.connected && {ok}")
    page.watch_a_game(held=False)
    assert page.get("vantage.state.frames.episode.header.players.hider") == "planner"
