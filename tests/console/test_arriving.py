"""The first minute of a visitor: this file runs before the others, on a table where nothing has been played."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser

from tests.console.browser import ConsolePage, address_of


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
    assert page.get("!vantage.state.frames.session.header.more_games && !vantage.state.frames.episode")
    games.blur()
    page.press("h")
    limits = {"games": welcome["limits"]["games"], "steps to survive": welcome["limits"]["steps"]}
    for label, most in limits.items():
        assert page.page.locator(".ask").get_by_label(label, exact=True).get_attribute("max") == str(most)
    assert page.page.get_by_label("name or pseudonym").get_attribute("maxlength") == str(welcome["limits"]["person"])


def test_a_first_visit_says_what_this_is_and_offers_both_ways(page: ConsolePage) -> None:
    invitation = page.page.locator(".invitation")
    assert "hide-and-seek" in invitation.inner_text()
    assert invitation.get_by_role("button").all_inner_texts() == ["Watch a game", "Play the hider"]
    assert page.page.locator(".view .empty:visible").count() == 6, "empty pictures say what they wait for"
    invitation.get_by_role("button", name="Watch a game").click()
    page.until("vantage.state.frames.episode?.header.phase === 'running'")
    assert invitation.is_hidden()


@pytest.mark.stack
def test_a_page_takes_no_other_deployment_for_its_own(browser: Browser) -> None:
    """Ports change hands: after `vantage down` another deployment may answer where an old page looks for its own."""
    home = Path(tempfile.mkdtemp(prefix="vantage-test-", dir="/tmp"))
    page = None
    try:
        for name in ("one", "other"):
            folder = home / name
            folder.mkdir(mode=0o700)
            port = 0 if page is None else urlsplit(page.address).port
            command = [sys.executable, "-m", "services.console", "--folder", str(folder), "--port", str(port)]
            with subprocess.Popen(command, stderr=subprocess.DEVNULL) as console:
                address = address_of(folder, 30)
                if page is None:
                    page = ConsolePage(browser, address)
                    page.offline = True
                else:
                    page.until("!document.getElementById('banner').hidden")
                    page.until("document.getElementById('banner').textContent.includes('another deployment answers')")
                    assert not page.get("vantage.state.connected")
                    page.offline = False
                    page.open()  # who reloads wants to see it
                console.terminate()
        page.offline = True
        page.close()
    finally:
        shutil.rmtree(home, ignore_errors=True)
