"""What was played before the page is looked at again: a human's game is the same game, and a replay is watched like any other."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.console.browser import OVER, PATIENCE, ConsolePage, address_of, wait_until
from tests.stack.table import VANTAGE, Table
from vantage.log import open_log
from vantage.log.episodes import games_of

pytestmark = pytest.mark.stack

STEPS = 20


@pytest.fixture(scope="module")
def log(browser: Browser) -> Iterator[Path]:
    """A whole log: a game of the planner's, and one that a person drove with the keyboard."""
    kept = Path(tempfile.mkdtemp(prefix="vantage-test-", dir="/tmp"))
    with Table() as table:
        page = ConsolePage(browser, address_of(table.folder))
        played = table.command("play", "--seed", "5", "--steps", str(STEPS), "--period", "0.1")
        assert played.returncode == 0, played.stdout + played.stderr
        page.until(OVER)
        page.begin_human_game(steps=3 * STEPS, key="ArrowRight")
        page.until(f"vantage.state.frames.tick.header.step >= 6 || {OVER}")
        page.page.keyboard.up("ArrowRight")
        page.page.keyboard.down("ArrowUp")
        page.until(OVER)
        page.page.keyboard.up("ArrowUp")
        page.close()
        table.deployment.stop()
        (recorded,) = table.logs.glob("*.mcap")
        shutil.copy(recorded, kept)
    yield next(kept.glob("*.mcap"))
    shutil.rmtree(kept)


def test_a_human_game_is_played_again_from_its_commands_and_is_the_same_game(log: Path) -> None:
    with open_log(log) as opened:
        by_planner, by_human = games_of(opened)
    assert (by_planner.episode.players.hider, by_human.episode.players.hider) == ("planner", "human")
    driven = [command.primitive for command in by_human.commands["hider"].values()]
    assert driven.count("right") >= 3 and driven.count("forward") >= 3
    wide = {**os.environ, "COLUMNS": "200"}
    outcome = subprocess.run([VANTAGE, "log", "verify", str(log)], capture_output=True, text=True, check=False, env=wide)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    text = " ".join(outcome.stdout.split())
    assert "hider: human" in text
    assert text.count("by simulator") >= 7, "poses, pictures and layout, all made again"


def test_a_replay_is_watched_like_a_game(log: Path, browser: Browser) -> None:
    home = Path(tempfile.mkdtemp(prefix="vantage-test-", dir="/tmp"))
    command = [str(VANTAGE), "replay", str(log), "--folder", str(home / "run")]
    playing = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        page = ConsolePage(browser, address_of(home / "run"))
        page.until("vantage.state.frames.playback?.header.state === 'playing'")
        assert page.page.locator(".replay").is_visible()
        state = "vantage.state.frames.playback.header.state"
        while page.get(state) != "paused":  # it may be at its end by now: then it plays again
            before = page.get(state)
            page.page.locator(".replay button").click()
            page.until(f"{state} !== '{before}'")
        # Into the middle of the planner's game: the map is there, and goals can be clicked.
        slider = page.page.get_by_label("Position in the log, s")
        with open_log(log) as opened:
            records = list(opened.records())
        start = records[0].log_time
        middle = [record.log_time for record in records if record.key == "tick"][STEPS // 2]
        slider.fill(f"{(middle - start) / 1e9:.2f}")
        page.until("vantage.state.frames['hider/plan']?.header.unpredictable === ''")
        assert page.get("vantage.state.frames.episode.header.players.hider") == "planner"
        page.until("vantage.state.frames.prediction?.header.steps.length > 0")
        jumps = page.get("vantage.state.frames.playback.header.jumps")
        # And to the end, fast: the human's game, which has no plan.
        page.page.locator(".replay button").click()
        page.page.locator(".replay").get_by_label("Speed").select_option("8")
        page.until("vantage.state.frames.playback.header.state === 'ended'")
        page.until("vantage.state.frames.episode.header.players.hider === 'human'")
        assert page.get("vantage.state.frames.episode.header.phase") == "ended"
        assert page.get("vantage.state.frames.playback.header.jumps") == jumps
        assert page.get("vantage.state.mode") == "watch", "nobody drives in a log"
        page.close()
        playing.send_signal(signal.SIGINT)
        said, _ = playing.communicate(timeout=PATIENCE)
        assert "http://127.0.0.1:" in said
        wait_until(lambda: not (home / "run" / "console.sock").exists() or not _alive(home / "run"), "the deployment is down")
    finally:
        if playing.poll() is None:
            playing.kill()
        shutil.rmtree(home, ignore_errors=True)


def _alive(folder: Path) -> bool:
    try:
        os.kill(int((folder / "supervisord.pid").read_text()), 0)
    except (OSError, ValueError):
        return False
    return True
