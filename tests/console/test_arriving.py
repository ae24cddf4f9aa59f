"""The first minute of a visitor: what a table where nothing was played says, what its forms take, and whose table it is."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser

from tests.console.browser import OVER, ConsolePage, address_of


@contextmanager
def console_alone(folder: Path, port: int = 0) -> Iterator[str]:
    """Run a console without any other service; yields its page's address."""
    folder.mkdir(mode=0o700)
    command = [sys.executable, "-m", "services.console", "--folder", str(folder), "--port", str(port)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as console:
        try:
            yield address_of(folder)
        finally:
            console.terminate()


@pytest.fixture
def home() -> Iterator[Path]:
    """A folder with a short name: sockets are made in it."""
    with tempfile.TemporaryDirectory(prefix="vantage-test-", dir="/tmp", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


@pytest.mark.stack
def test_a_first_visit_says_what_this_is_and_offers_both_ways(home: Path, browser: Browser) -> None:
    """At a console of its own: on a table that others play on, too, it is nobody's first visit."""
    with console_alone(home / "one") as address:
        page = ConsolePage(browser, address)
        invitation = page.page.locator(".invitation")
        assert "hide-and-seek" in invitation.inner_text()
        assert invitation.get_by_role("button").all_inner_texts() == ["Watch a game", "Play the hider"]
        assert page.page.locator(".view .empty:visible").count() == 6, "empty pictures say what they wait for"
        assert page.page.locator(".prediction.blank canvas:visible").count() > 0
        assert page.page.locator(".prediction .percent:visible").count() == 0, "nothing is called caught that was not predicted"
        invitation.get_by_role("button", name="Watch a game").click()
        assert [request["type"] for request in page.get("window.asked")] == ["start"]
        page.close()


def test_whoever_is_invited_to_watch_a_game_sees_one(page: ConsolePage) -> None:
    invitation = page.page.locator(".invitation")
    game = "vantage.state.frames.episode?.header"
    before = page.get(f"{game}?.episode ?? 0")
    invitation.get_by_role("button", name=re.compile("^Watch (a|another) game$")).click()
    page.until(f"{game}?.episode > {before}")
    page.until(f"document.querySelector('.invitation').hidden || {OVER}")


def test_forms_offer_what_the_console_takes_and_a_form_that_is_wrong_starts_nothing(page: ConsolePage) -> None:
    welcome = page.get("vantage.state.frames.welcome.header")
    options = "(e) => [...e.options].map((option) => option.value)"
    for field, names in (("layout", welcome["layouts"]), ("seeker", welcome["seekers"])):
        assert page.page.locator(".bar").get_by_label(field).evaluate(options) == names
    games = page.page.locator(".bar").get_by_label("games", exact=True)
    for wrong in ("", str(welcome["limits"]["games"] + 1), "1.5"):
        games.fill(wrong)
        games.blur()
        page.press("g")
        assert page.get("document.activeElement.matches('input:invalid')"), "it is pointed at"
    assert "start" not in [request["type"] for request in page.get("window.asked")]
    games.blur()
    page.press("h")
    limits = {"games": welcome["limits"]["games"], "steps to survive": welcome["limits"]["steps"]}
    for label, most in limits.items():
        assert page.page.locator(".ask").get_by_label(label, exact=True).get_attribute("max") == str(most)
    assert page.page.get_by_label("name or pseudonym").get_attribute("maxlength") == str(welcome["limits"]["person"])


@pytest.mark.stack
def test_a_page_takes_no_other_deployment_for_its_own(home: Path, browser: Browser) -> None:
    """Ports change hands: after `vantage down` another deployment may answer where an old page looks for its own."""
    with console_alone(home / "one") as address:
        page = ConsolePage(browser, address)
        page.offline = True
    with console_alone(home / "other", urlsplit(address).port or 0) as other:
        page.until("!document.getElementById('banner').hidden")
        page.until("document.getElementById('banner').textContent.includes('Open the address with #token=')", 30.0)
        assert not page.get("vantage.state.connected")
        page.offline = False
        page.address = other
        page.open()
        page.offline = True
    page.close()


@pytest.mark.stack
def test_the_token_leaves_the_address_and_stays_for_the_tab(home: Path, browser: Browser) -> None:
    with console_alone(home / "one") as address:
        page = ConsolePage(browser, address)
        place, _, token = address.partition("#token=")
        assert token
        assert page.page.url == place
        assert token not in page.get("JSON.stringify(history.state) + document.documentElement.outerHTML")
        page.page.reload()
        page.until("vantage.state.connected && vantage.state.frames.welcome")
        page.page.evaluate("(token) => { window.old = true; location.hash = `token=${token}`; }", token)  # pasted into this tab
        page.page.wait_for_function("() => !window.old && window.vantage?.state.connected")
        page.until("vantage.state.frames.welcome")
        assert page.page.url == place
        stranger = page.page.context.browser.new_page()
        stranger.goto(place)
        stranger.wait_for_function("() => !document.getElementById('banner').hidden")
        assert "Open the address with #token=" in stranger.locator("#banner").inner_text()
        stranger.close()
        page.close()
