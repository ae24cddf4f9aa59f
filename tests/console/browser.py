"""A real Chromium, and one page of the console in it that notes everything it should not have done."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from playwright.sync_api import Browser, Page, sync_playwright

PATIENCE = 120.0
"""Seconds until a wait fails. It bounds failures only: no test is to depend on how fast the machine is."""
ON = "['setup', 'running'].includes(vantage.state.frames.episode?.header.phase)"
OVER = "['ended', 'aborted'].includes(vantage.state.frames.episode?.header.phase)"
PAUSED = "(vantage.state.frames.episode?.header.phase === 'running' && vantage.state.frames.episode.header.paused)"
GAME = "(vantage.state.frames.episode?.header.episode ?? 0)"
PLANNED = """(vantage.state.frames['hider/plan']?.header.unpredictable === ''
  && vantage.state.frames['hider/plan'].header.episode === vantage.state.frames.episode?.header.episode)"""
"""The present game has a plan whose goals can be asked about."""

NOTES = """
window.violations = [];
window.sockets = [];
window.asked = []; // what this page sent
window.WebSocket = class extends WebSocket {
  constructor(...given) {
    super(...given);
    window.sockets.push(this);
  }
  send(text) {
    window.asked.push(JSON.parse(text));
    super.send(text);
  }
};
document.addEventListener('securitypolicyviolation', ({ violatedDirective, blockedURI }) => {
  window.violations.push(`${violatedDirective} ${blockedURI}`);
});
"""


@contextmanager
def chromium() -> Iterator[Browser]:
    """Run a browser without a window. Fails where none is installed: `make setup` does that."""
    path = shutil.which("chromium")
    assert path is not None, "the tests of the page need `chromium` on the path: apt-get install chromium"
    with sync_playwright() as playwright:
        # Without a sandbox: the tests also run as root, in containers.
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


def address_of(folder: Path, timeout: float = PATIENCE) -> str:
    """Return the address that the console of a deployment has written into its folder."""
    place = folder / "console.address"
    wait_until(lambda: place.is_file() and bool(place.read_text().strip()), "the console's address", timeout)
    return place.read_text().strip()


def wait_until(so: Callable[[], object], what: str, timeout: float = PATIENCE) -> None:
    """Ask again and again until something is so; fails after `timeout` seconds."""
    deadline = time.monotonic() + timeout
    while not so():
        assert time.monotonic() < deadline, f"{what}: not within {timeout:g} s"
        time.sleep(0.05)


class ConsolePage:
    """One page. `close` fails if it logged an error, broke its own security policy or asked another host for something."""

    def __init__(
        self, browser: Browser, address: str, width: int = 1440, height: int = 900, theme: Literal["dark", "light"] = "dark"
    ) -> None:
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=theme, reduced_motion="reduce")
        context.add_init_script(NOTES)
        self.page: Page = context.new_page()
        self.address = address
        self.errors: list[str] = []
        self.hosts: set[str] = set()
        self.offline = False  # on purpose: then a failed connection is no error
        self.page.on("console", lambda message: self._note(message.text) if message.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.hosts.add(urlsplit(request.url).netloc))
        self.page.on("websocket", lambda socket: self.hosts.add(urlsplit(socket.url).netloc))
        self.open()

    def _note(self, text: str) -> None:
        if not (self.offline and "WebSocket connection" in text):
            self.errors.append(text)

    def open(self) -> None:
        self.page.goto("about:blank")  # else only the fragment would differ, which is no navigation
        self.page.goto(self.address)
        self.until("vantage.state.connected && vantage.state.frames.welcome && vantage.state.frames.services")

    def get(self, expression: str) -> Any:
        """Evaluate JavaScript: past the page's security policy, which forbids it strings of code."""
        return self.page.evaluate(f"() => {expression}")

    def until(self, expression: str) -> None:
        """Wait until something is so on the page."""
        wait_until(lambda: self.get(f"Boolean({expression})"), expression)

    def watch_a_game(self, so: str = "true", held: bool = True) -> None:
        """Watch a planner's game until something is so, and hold its clock there.

        A game that is over before that (caught; aborted by a busy machine) is followed by another one.

        Args:
            so: JavaScript; it is also true when this returns, of a game with a plan.
            held: whether the clock is to stand still, so that what is judged does not change.
        """
        so = f"({PLANNED} && ({so}))"
        while True:
            self._start_game()
            self.until(f"{so} || {OVER}")
            if held and not self.get(OVER):
                self.press(" ")
                self.until(f"{PAUSED} || {OVER}")
                self.be_painted()
            if self.get(f"{so} && {PAUSED if held else ON}"):
                return
            self.idle()

    def _start_game(self) -> None:
        if self.get(ON):
            return
        before = self.get(GAME)
        self.get("document.activeElement?.blur()")  # in a field, a key is a letter
        self.press("g")
        self.until(f"{GAME} > {before} || document.querySelector('#notices p')")  # refused: the page says so, once more
        if self.get(f"{GAME} === {before}"):
            self.until("!document.querySelector('#notices p')")
            self._start_game()

    def hold_human_game(self, so: str, **game: Any) -> None:
        """Begin games of a human's until one is held in which something is so."""
        while True:
            self.begin_human_game(**game)
            self.until(f"({so}) || {OVER}")
            if not self.get(OVER):
                self.press(" ")
                self.until(f"{PAUSED} || {OVER}")
                self.be_painted()
            if self.get(f"({so}) && {PAUSED}"):
                return
            self.idle()

    def be_painted(self) -> None:
        """Wait until what the page knows by now is drawn: in the display frame after it came, at the latest."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)

    def text(self, selector: str) -> str:
        return self.page.locator(selector).first.inner_text()

    def idle(self) -> None:
        """End whatever is played, and be in the mode that watches."""
        if self.get("vantage.state.mode") == "play":
            self.page.once("dialog", lambda dialog: dialog.accept())
            self.press("Escape")
            self.until("vantage.state.mode === 'watch' && vantage.state.connected && vantage.state.frames.services")
        more = "vantage.state.frames.session?.header.more_games"
        if self.get(f"{ON} || {more}"):
            self.press("x")
            self.until(f"!{ON} && !{more}")

    def begin_human_game(
        self, games: int = 1, steps: int = 30, period: float = 0.1, seed: int = 3, name: str = "", key: str = ""
    ) -> None:
        """Enter play mode with the keyboard, fill the form in, and play through the count-down.

        Args:
            key: held through it, so that it counts from the first step on.
        """
        self.ask_for_human_game(games, steps, period, seed, name)
        if key:
            self.page.keyboard.down(key)
        self.wait_for_game()

    def ask_for_human_game(self, games: int = 1, steps: int = 30, period: float = 0.1, seed: int = 3, name: str = "") -> None:
        """Enter play mode with the keyboard, fill the form in, and begin the count-down."""
        self.press("h")
        for label, value in (("games", games), ("steps to survive", steps), ("step [s]", period), ("seed", seed)):
            self.page.locator(".ask").get_by_label(label, exact=True).fill(str(value))
        self.page.get_by_label("name or pseudonym").fill(name or "not to be stored")
        self.page.get_by_label("store it with the recording").set_checked(bool(name))
        self.page.locator(".ask button.primary").click()
        self.until("vantage.state.play?.phase === 'count'")

    def wait_for_game(self) -> None:
        """Wait until the game runs, or is over already; one that a busy machine aborted is played again."""
        over = "['between', 'done'].includes(vantage.state.play?.phase)"
        while True:
            self.until(
                f"{over} || vantage.state.play?.phase === 'game' && vantage.state.frames.episode.header.phase === 'running'"
            )
            if not self.get(f"{over} && vantage.state.play.games.at(-1)?.outcome === 'undecided'"):
                return
            self.press("Enter")

    def lose_connection(self) -> None:
        """Close the page's WebSocket, as a network that drops does, and wait until it noticed."""
        self.get("window.sockets.at(-1).close()")
        self.until("!vantage.state.connected")

    def close(self) -> None:
        violations = self.get("window.violations")
        self.page.context.close()
        assert not violations
        assert not self.errors
        assert self.hosts == {urlsplit(self.address).netloc}
