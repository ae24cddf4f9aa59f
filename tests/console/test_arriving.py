"""The first minute of a visitor: this file runs before the others, on a table where nothing has been played."""

from __future__ import annotations

from tests.console.browser import ConsolePage


def test_a_first_visit_says_what_this_is_and_offers_both_ways(page: ConsolePage) -> None:
    invitation = page.page.locator(".invitation")
    assert "hide-and-seek" in invitation.inner_text()
    assert invitation.get_by_role("button").all_inner_texts() == ["Watch a game", "Play the hider"]
    assert page.page.locator(".view .empty:visible").count() == 6, "empty pictures say what they wait for"
    invitation.get_by_role("button", name="Watch a game").click()
    page.until("vantage.state.frames.episode?.header.phase === 'running'")
    assert invitation.is_hidden()
