"""The first minute of a visitor: this file runs before the others, on a table where nothing has been played."""

from __future__ import annotations

from tests.console.browser import ConsolePage


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
