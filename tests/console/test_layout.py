"""The page on large and small screens, with text of strangers: nothing overlaps, is cut or gives orders."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable

import pytest

from tests.console.browser import ConsolePage

OVERLAPS = """(() => {
  const boxes = [...document.querySelectorAll('.panel, #header, #footer > *')].filter((e) => e.offsetParent)
    .map((e) => [e.className || e.id, e.getBoundingClientRect()]);
  const found = [];
  boxes.forEach(([a, p], i) => boxes.slice(i + 1).forEach(([b, q]) => {
    const apart = p.left >= q.right - 1 || q.left >= p.right - 1 || p.top >= q.bottom - 1 || q.top >= p.bottom - 1;
    if (!apart) found.push(`${a} over ${b}`);
  }));
  return found;
})()"""
CUT = """[...document.querySelectorAll('h2, h3, button, .field, .fact, .caption, .chip, .legend li, figcaption, .classes li')]
  .filter((e) => e.offsetParent && (e.scrollWidth > e.clientWidth + 1) && getComputedStyle(e).display !== 'inline')
  .map((e) => e.textContent)"""


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (1920, 1080)])
def test_nothing_overlaps_is_cut_or_needs_scrolling(open_page: Callable[..., ConsolePage], width: int, height: int) -> None:
    page = open_page(width=width, height=height)
    page.watch_a_game(ALL_DRAWN)
    assert page.get("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == [width, height]
    assert page.get(OVERLAPS) == []
    assert page.get(CUT) == []
    assert page.get("[...document.querySelectorAll('.panel')].filter((e) => e.scrollHeight > e.clientHeight + 1).length") == 0


ALL_DRAWN = """document.querySelectorAll('.prediction:not(.blank)').length
  && [...document.querySelectorAll('.view canvas')].every((canvas) => !canvas.hidden)"""
SMALL = [(1024, 768), (800, 600), (640, 400), (390, 844), (360, 640)]
"""px. 640 x 400 is a screen of 1280 x 800 at 200 %."""
NARROW = 960
HIDDEN_BY_OTHERS = """(() => [...document.querySelectorAll('button, input, select')].filter((e) => e.offsetParent && !e.disabled)
  .filter((e) => {
    e.scrollIntoView({ block: 'center' });
    const { left, right, top, bottom } = e.getBoundingClientRect();
    const found = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
    return !found || !(e.contains(found) || found.contains(e) || found.closest('label')?.contains(e));
  }).map((e) => e.textContent || e.ariaLabel || e.closest('label')?.textContent))()"""
"""What can be pressed and yet is covered by something, or beyond the edge, where it was scrolled to."""


@pytest.mark.parametrize(("width", "height"), SMALL)
def test_a_small_screen_scrolls_down_only_and_everything_can_be_seen_and_pressed(
    open_page: Callable[..., ConsolePage], width: int, height: int
) -> None:
    page = open_page(width=width, height=height)
    assert page.get("document.documentElement.scrollWidth") == width, "before a game"
    assert page.get(OVERLAPS) == []
    assert page.get(HIDDEN_BY_OTHERS) == []
    page.watch_a_game(ALL_DRAWN)
    assert page.get("document.documentElement.scrollWidth") == width
    assert page.get(OVERLAPS) == []
    assert page.get(CUT) == []
    assert page.get(HIDDEN_BY_OTHERS) == []
    arena = page.page.locator(".stage").bounding_box()
    assert arena is not None and min(arena["width"], arena["height"]) >= min(260, 0.8 * width), "the arena can be read"
    pictures = [picture.bounding_box() for picture in page.page.locator(".view canvas").all()]
    assert all(box is not None and box["width"] >= 60 and box["height"] >= 40 for box in pictures)
    apart = """[...document.querySelectorAll('.view canvas, .stage, .prediction canvas')].map((e) => e.getBoundingClientRect())
      .flatMap((p, i, all) => all.slice(i + 1).filter((q) => p.left < q.right - 1 && q.left < p.right - 1
        && p.top < q.bottom - 1 && q.top < p.bottom - 1)).length"""
    assert page.get(apart) == 0, "no picture lies over another"
    if width < NARROW:
        assert page.get("new Set([...document.querySelectorAll('.panel')].map((e) => e.getBoundingClientRect().left)).size") == 1
    page.page.locator(".stage").hover()
    page.until("document.querySelector('.arena > .facts').textContent.startsWith('Goal (')")


@pytest.mark.parametrize(("width", "height"), SMALL[::2])
def test_on_a_small_screen_the_hider_is_played(open_page: Callable[..., ConsolePage], width: int, height: int) -> None:
    page = open_page(width=width, height=height)
    page.press("h")
    page.until("document.querySelector('.ask')")
    assert page.get("document.documentElement.scrollWidth") == width
    assert page.get(CUT) == []
    assert page.get(HIDDEN_BY_OTHERS) == []
    page.press("Escape")
    page.hold_human_game("vantage.state.frames['hider/color'] && vantage.state.frames['hider/view']", steps=400, seed=11)
    page.press("i")
    page.be_painted()
    assert page.get("document.documentElement.scrollWidth") == width
    assert page.get(HIDDEN_BY_OTHERS) == []
    for picture in page.page.locator(".play canvas").all():
        box = picture.bounding_box()
        assert box is not None and min(box["width"], box["height"]) >= 100


HOSTILE = {
    "markup": "<img src=x onerror=window.hurt=1><script>window.hurt=1</script>&lt;b&gt;[red]x[/red]",
    "direction": "\u202egnirts a\u202c \u2067abc\u2069 \u200f\u061c end",
    "control": "\x1b[31mred\x1b[0m\x07\x00 \x9b2J line\r\nline\u2028line",
    "endless": "x" * 10_000,
    "hebrew": "\u05e9\u05dc\u05d5\u05dd",
}
RECEIVE = """async ([key, head]) => {
  (await import('./state.js')).receive({ key, ...head }, new Uint8Array());
}"""


@pytest.mark.parametrize("kind", sorted(HOSTILE))
def test_text_of_strangers_is_text(open_page: Callable[..., ConsolePage], kind: str) -> None:
    """Reasons and names come over the bus: they are shown as they are, without what is not seen, and not for ever."""
    page, text = open_page(), HOSTILE[kind]
    welcome = page.get("vantage.state.frames.welcome.header")
    row = {"service": text, "state": "degraded", "reason": text, "age": 0.1, "uptime": 1.0, "lost": 0, "bad": 0}
    rules = {"maximum_steps": 5, "step_period": 0.1}
    game = {
        "episode": 7,
        "seed": 1,
        "phase": "aborted",
        "rules": rules,
        "players": {"hider": text, "seeker": text},
        "reason": text,
    }
    # For good: else the next frame of the console takes the place of what is to be seen.
    page.get("void (window.WebSocket = class { close() {} })")
    page.lose_connection()
    for key, head in (
        ("welcome", {**welcome, "deployment": text, "arena": text}),
        ("services", {"services": [row]}),
        ("recording", {"state": "trouble", "reason": text}),
        ("notice", {"level": "warning", "text": text}),
        ("episode", game),
    ):
        page.page.evaluate(RECEIVE, [key, head])
    page.be_painted()
    shown = page.get("[document.body.innerText, ...[...document.querySelectorAll('[title]')].map((e) => e.title)].join('\\n')")
    assert not [letter for letter in shown if letter not in "\n\t" and unicodedata.category(letter) in ("Cc", "Cf", "Zl")]
    assert page.get("window.hurt") is None
    assert page.get("document.querySelectorAll('main img, main script').length") == 0
    assert len(shown) < 40_000
    if kind == "markup":
        assert text in shown, "word for word"
    assert page.get("document.documentElement.scrollWidth") == 1440
