"""Somebody watches: a first visit, a live game, predictions by mouse and keyboard, reloads, restarts, stale pictures."""

from __future__ import annotations

import cmath
import math
import os
import re
import signal
from collections.abc import Callable

import pytest

from tests.console.browser import GAME, OVER, PAUSED, ConsolePage, wait_until
from tests.stack.table import Table

RUNNING = "vantage.state.frames.episode?.header.phase === 'running'"
PREDICTED = "vantage.state.frames.prediction?.header.steps.length > 1"
TRUE_VIEW = f"({PREDICTED} && document.querySelector('.actual span')?.hidden)"
"""The first predicted step is over, and what the seeker truly saw then stands below."""


def test_every_panel_has_a_title_and_an_explanation_and_every_field_a_label(page: ConsolePage) -> None:
    for panel in page.page.locator(".panel").all():
        assert panel.locator("h2").first.inner_text().strip()  # the first visit adds another
        assert panel.locator(".explanation").inner_text().strip()
    unnamed = page.get("[...document.querySelectorAll('input, select')].filter((e) => !e.labels.length && !e.ariaLabel).length")
    assert unnamed == 0


def test_a_live_game_is_seen_whole(page: ConsolePage) -> None:
    keys = [f"{robot}/{part}" for robot in ("hider", "seeker") for part in ("pose", "color", "depth", "view")]
    there = f"{keys}.every((key) => vantage.state.frames[key]) && vantage.state.frames.layout"
    drawn = "[...document.querySelectorAll('.view canvas')].every((canvas) => !canvas.hidden && canvas.width > 100)"
    page.watch_a_game(f"{there} && {drawn} && vantage.state.paths.hider.length > 8")
    canvas = "document.querySelector('.view canvas')"
    colors = page.get(f"new Set(new Uint32Array({canvas}.getContext('2d').getImageData(0, 0, 160, 120).data.buffer)).size")
    assert colors > 50, "the hider's colour picture is drawn"
    assert page.get("vantage.painted.some(([key, stamp, at]) => key === 'hider/color' && /^\\d{19}$/.test(stamp) && at > 1e12)")
    assert "paused" in page.text(".chip")
    assert re.search(r"\(every 10 steps\)\. Planned in \d+ ms\.$", page.text(".arena > .facts"))
    assert page.page.locator(".health tbody tr").count() == len(page.get("vantage.state.frames.services.header.services"))


def test_the_row_of_predictions_fills_itself_and_the_truth_comes_under_it(page: ConsolePage) -> None:
    # At the first predicted step the true view takes the place of "in n steps".
    page.watch_a_game(TRUE_VIEW)
    assert page.page.locator(".prediction:not(.blank)").count() == page.get("vantage.state.frames.prediction.header.steps.length")
    assert page.page.locator(".percent").first.inner_text().endswith("% caught")
    first = page.get("vantage.state.frames.prediction.header.steps[0]")
    assert page.get(f"vantage.state.past.get({first}).length") == 128 * 128
    # After the network was away for a moment the row fills itself again.
    page.lose_connection()
    page.until("vantage.state.connected && vantage.state.frames.prediction?.header.steps.length > 0")
    assert page.get("vantage.state.frames.prediction.header.steps[0]") == first
    page.until(f"vantage.state.past.get({first}) && document.querySelector('.actual span').hidden")


# Of each predicted step: whether the canvases show its prediction, and its truth.
SHOWN_UNDER_STEPS = """async () => {
  const { paintPredicted, paintView } = await import('./pictures.js');
  const { header, payload } = vantage.state.frames.prediction;
  const pixels = (canvas) => canvas.getContext('2d').getImageData(0, 0, 128, 128).data.join();
  const painted = (paint, ...more) => {
    const canvas = document.createElement('canvas');
    paint(canvas, ...more);
    return pixels(canvas);
  };
  const size = 128 * 128 * 3;
  return [...document.querySelectorAll('.prediction')].map((cell, i) => {
    const [predicted, actual] = cell.querySelectorAll('canvas');
    const truth = vantage.state.past.get(header.steps[i]);
    return [
      pixels(predicted) === painted(paintPredicted, payload.slice(i * size, (i + 1) * size)),
      truth ? pixels(actual) === painted(paintView, truth, 'seeker') : null,
    ];
  });
}"""


def test_each_prediction_and_each_true_view_is_shown_under_its_own_step(page: ConsolePage) -> None:
    page.watch_a_game(TRUE_VIEW)
    found = page.page.evaluate(SHOWN_UNDER_STEPS)
    assert all(predicted for predicted, _ in found)
    assert {true for _, true in found if true is not None} == {True}


def test_boxes_and_what_they_hide_are_where_they_are(page: ConsolePage) -> None:
    boxes = [{"x": 0.33, "y": 0.81, "half_width": 0.12, "half_depth": 0.06, "heading": 0.5}]
    found = page.page.evaluate("async (boxes) => boxes.map((await import('./visibility.js')).corners)", boxes)
    turned = cmath.exp(0.5j)
    expected = [complex(0.33, 0.81) + turned * complex(x, y) for x in (-0.12, 0.12) for y in (-0.06, 0.06)]
    assert len(found[0]) == 4
    for corner in expected:
        assert min(abs(complex(*point) - corner) for point in found[0]) < 1e-9
    # Looking along +y, the box is ahead on the left: there the view ends at it, on the right at the wall.
    pose = {"x": 0.6, "y": 0.2, "heading": math.pi / 2}
    box = {"x": 0.45, "y": 0.5, "half_width": 0.05, "half_depth": 0.05, "heading": 0.0}
    view = page.page.evaluate(
        "async ([pose, box]) => (await import('./visibility.js')).viewOf(pose, 1.0, [box], 1.2, 1.2)", [pose, box]
    )
    assert view[0] == [0.6, 0.2]
    assert min(y for x, y in view[1:] if x > 0.6) > 1.19
    assert any(0.4 <= x <= 0.5 and abs(y - 0.45) < 1e-6 for x, y in view[1:])
    angles = [math.atan2(y - 0.2, x - 0.6) - math.pi / 2 for x, y in view[1:]]
    assert (min(angles), max(angles)) == (pytest.approx(-0.5), pytest.approx(0.5))


def test_a_goal_that_is_clicked_gets_its_predicted_views(page: ConsolePage) -> None:
    page.watch_a_game(PREDICTED)
    own = page.get("vantage.state.frames['hider/plan'].header.goal")
    box = page.page.locator(".stage").bounding_box()
    assert box is not None
    x, y = page.get(f"vantage.state.frames.welcome.header.goals[{own}]")
    name_of_own = f"Goal ({x:.2f}, {y:.2f}) m"
    line = page.page.locator(".arena .facts")

    def find_another_goal() -> tuple[float, float]:
        for x in range(60, int(box["width"]), 18):
            for y in range(20, int(box["height"]), 18):
                page.page.mouse.move(box["x"] + x, box["y"] + y)
                said = line.inner_text()
                if said.startswith("Goal") and "danger" in said and not said.startswith(name_of_own):
                    return box["x"] + x + 8, box["y"] + y + 8  # not on its edge
        raise AssertionError("no open goal under the mouse")

    page.page.mouse.click(*find_another_goal())
    page.until(f"vantage.state.goal !== null && vantage.state.goal !== {own}")
    page.until("vantage.state.frames.prediction.header.goal === vantage.state.goal")
    page.until("document.querySelector('.predictions .facts').innerText.includes('your goal')")
    painted = "document.querySelector('.prediction canvas').getContext('2d').getImageData(0, 0, 128, 128).data"
    assert page.get(f"{painted}.some((value, i) => i % 4 < 3 && value > 0)")


def test_goals_are_chosen_with_the_keyboard(page: ConsolePage) -> None:
    middle = 60  # where the keyboard begins
    while True:  # until a layout has a goal that is blocked, and one open above the middle
        page.watch_a_game()
        values = page.get("vantage.state.frames['hider/plan'].header.values")
        above = [goal for goal in range(middle + 11, 121, 11) if values[goal] is not None]
        if above and None in values:
            break
        page.idle()
    page.press("m")
    goal = above[0]
    page.press(*["ArrowUp"] * ((goal - middle) // 11))
    page.press("Enter")
    page.until(f"vantage.state.frames.prediction?.header.goal === {goal}")
    blocked = values.index(None)
    up, right = blocked // 11 - goal // 11, blocked % 11 - goal % 11
    page.press(*["ArrowUp" if up > 0 else "ArrowDown"] * abs(up), *["ArrowRight" if right > 0 else "ArrowLeft"] * abs(right))
    page.press("Enter")
    x, y = page.get(f"vantage.state.frames.welcome.header.goals[{blocked}]")
    assert page.text(".arena > .facts") == f"Goal ({x:.2f}, {y:.2f}) m: blocked; no way leads there."


def test_a_reload_in_mid_game_shows_the_game_as_it_was(page: ConsolePage) -> None:
    page.watch_a_game("vantage.state.paths.hider.length > 6")
    before = page.get("vantage.state.frames.episode.header.episode")
    page.page.reload()
    page.until(f"{RUNNING} && vantage.state.frames['hider/plan'] && vantage.state.paths.hider.length > 6")
    assert page.get("vantage.state.frames.episode.header.episode") == before
    assert page.get("vantage.state.paths.hider[0][0]") == 0, "from the start of the game"


def test_a_second_page_sees_the_same(page: ConsolePage, open_page: Callable[..., ConsolePage]) -> None:
    page.watch_a_game("vantage.state.paths.hider.length > 6")
    other = open_page(width=1920, height=1080, theme="light")
    other.until(f"{RUNNING} && vantage.state.frames['hider/plan'] && vantage.state.paths.hider[0]?.[0] === 0")


def test_pause_holds_the_clock_and_nothing_is_called_stale(page: ConsolePage) -> None:
    page.watch_a_game()
    assert "paused" in page.text(".chip")
    held = page.get("Date.now()")
    page.until(f"Date.now() > {held} + 2000")  # longer than a picture of a running game may take
    assert page.page.locator(".view.stale").count() == 0
    step = page.get("vantage.state.frames.tick?.header.step ?? 0")
    page.press(" ")
    page.until(f"vantage.state.frames.tick?.header.step > {step} || {OVER}")


def test_between_games_a_series_goes_on_or_is_stopped(page: ConsolePage) -> None:
    bar = page.page.locator(".bar")
    for label, value in (("games", "0"), ("T [steps]", "1"), ("step [s]", "1")):
        bar.get_by_label(label, exact=True).fill(value)
    between = "vantage.state.frames.episode.header.phase === 'ended' && vantage.state.frames.session.header.paused"
    bar.get_by_role("button", name="Start").click()
    page.until(RUNNING)
    page.press(" ")  # in the only step: the game ends, the next one waits
    page.until(between)
    assert page.page.locator(".invitation").is_hidden()
    first = page.get("vantage.state.frames.episode.header.episode")
    bar.get_by_role("button", name="Go on").click()
    page.until(f"{RUNNING} && vantage.state.frames.episode.header.episode > {first}")
    page.press(" ")
    page.until(between)
    assert bar.get_by_role("button", name="Stop").is_enabled()
    page.press("x")
    page.until("!vantage.state.frames.session.header.more_games && !document.querySelector('.invitation').hidden")
    assert bar.get_by_role("button", name="Stop").is_disabled()


CROWD = """(() => {
  others = others.filter((socket) => socket.readyState <= WebSocket.OPEN);
  while (others.length < 32) others.push(new WebSocket(sockets[0].url, ['vantage']));
  // The page's own is the one that takes its messages as buffers.
  if (vantage.state.connected) sockets.filter((socket) => socket.binaryType === 'arraybuffer').at(-1).close();
})()"""


def test_a_console_that_is_full_says_so_until_it_is_not(page: ConsolePage) -> None:
    page.offline = True
    page.get("window.others = []")
    said = "document.getElementById('banner').textContent.includes('pages are open')"
    wait_until(lambda: (page.get(CROWD), page.get(said))[1], "what the full console says")
    assert page.get("document.querySelector('#banner [aria-hidden]').textContent").endswith(" s")
    assert page.get("document.querySelector('#banner :not([aria-hidden])').textContent.match(/\\d+ s/)") is None
    page.get("others.forEach((socket) => socket.close())")
    page.until("vantage.state.connected && document.getElementById('banner').hidden")
    page.offline = False


NOTE_BANNERS = """(() => {
  window.banners = [];
  const banner = document.getElementById('banner');
  const note = () => banner.hidden || window.banners.push(banner.textContent);
  new MutationObserver(note).observe(banner, { attributes: true, childList: true, characterData: true, subtree: true });
})()"""


def test_when_the_console_is_restarted_the_page_says_so_and_comes_back(page: ConsolePage, table: Table) -> None:
    page.watch_a_game()
    before = page.get(GAME)
    page.offline = True
    pid = table.pid_of("console")
    page.get(NOTE_BANNERS)  # the next console may be there before this test has looked
    os.kill(pid, signal.SIGKILL)
    page.until("window.banners.some((text) => text.includes('No connection to the console'))")
    page.until(f"vantage.state.connected && {GAME} === {before}")
    page.until("document.getElementById('banner').hidden")
    page.until("document.querySelector('.predictions .facts').textContent.endsWith('can be clicked from the next game on.')")
    page.page.locator(".stage").click()
    assert page.text(".arena > .facts") == page.text(".predictions .facts"), "a click on a goal is told the same"
    wait_until(lambda: table.pid_of("console") not in (0, pid), "another console")
    page.offline = False


def test_pictures_that_do_not_come_are_dimmed_and_say_how_old_they_are(page: ConsolePage, table: Table) -> None:
    frozen = freeze_a_running_game(page, table)
    try:
        page.until("document.querySelectorAll('.view.stale').length >= 4")
        assert "s old" in page.text(".view.stale .age")
        page.get("delete vantage.state.frames['hider/color']")  # as to a console that came later: it has none
        page.until("document.querySelector('.view:not(.stale) .age')?.textContent === ''")
        assert page.get("document.querySelector('.view .empty').textContent") == "waits for a picture"
    finally:
        for pid in frozen:
            os.kill(pid, signal.SIGCONT)
    page.until("document.querySelectorAll('.view.stale').length === 0")


def freeze_a_running_game(page: ConsolePage, table: Table) -> list[int]:
    """Stop the simulator, whose pictures then do not come, and the referee, which would give the game up. Return their pids."""
    pids = [table.pid_of(service) for service in ("referee", "simulator")]
    while True:
        page.watch_a_game("vantage.state.frames['hider/color']", held=False)
        os.kill(pids[0], signal.SIGSTOP)
        # What the referee published before comes within a second: the console hears services once a second, too.
        page.until("vantage.state.frames.services.header.services.find((each) => each.service === 'referee').state === 'silent'")
        if page.get(f"{RUNNING} && !{PAUSED}"):
            os.kill(pids[1], signal.SIGSTOP)
            return pids
        os.kill(pids[0], signal.SIGCONT)


def test_help_is_a_key_away_and_the_theme_is_kept(page: ConsolePage) -> None:
    page.press("?")
    assert page.page.locator("dialog").is_visible()
    page.press("Escape")
    assert page.page.locator("dialog").is_hidden()
    assert page.get("document.documentElement.dataset.theme") == "dark"
    page.press("t")
    assert page.get("document.documentElement.dataset.theme") == "light"
    page.page.reload()
    page.until("vantage.state.frames.welcome")
    assert page.get("document.documentElement.dataset.theme") == "light"
