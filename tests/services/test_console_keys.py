"""Keys become one primitive a step."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from schemas import PRIMITIVES, Primitive
from services.console.human import Keys


def test_what_is_held_counts_at_every_step_the_last_pressed_first() -> None:
    keys = Keys()
    assert keys.take() == "stay"
    keys.press("forward")
    assert [keys.take() for _ in range(3)] == ["forward"] * 3
    keys.press("left")
    assert keys.take() == "left"
    keys.release("left")
    assert keys.take() == "forward"
    keys.release("forward")
    assert keys.take() == "stay"


def test_a_tap_between_two_steps_counts_once_also_while_another_key_is_held() -> None:
    keys = Keys()
    keys.press("left")
    keys.release("left")
    assert [keys.take(), keys.take()] == ["left", "stay"]
    keys.press("forward")
    keys.take()
    keys.press("right")
    keys.release("right")
    assert [keys.take(), keys.take()] == ["right", "forward"]
    for _ in range(3):
        keys.press("left")
        keys.release("left")
    assert [keys.take(), keys.take()] == ["left", "forward"]


events = st.lists(st.tuples(st.sampled_from(["press", "release", "step"]), st.sampled_from(PRIMITIVES)), max_size=60)


@given(events)
def test_no_key_acts_longer_than_it_was_held(played: list[tuple[str, Primitive]]) -> None:
    """Each step's primitive was held at the step, or came and went since the step before; and keys that came are not lost."""
    keys = Keys()
    held: list[Primitive] = []
    tapped: list[Primitive] = []
    fresh: set[Primitive] = set()
    for what, primitive in played:
        if what == "press":
            keys.press(primitive)
            if primitive not in held:
                held.append(primitive)
                fresh.add(primitive)
        elif what == "release":
            keys.release(primitive)
            if primitive in held:
                held.remove(primitive)
                if primitive in fresh:
                    tapped.append(primitive)
                    fresh.discard(primitive)
        else:
            taken = keys.take()
            if tapped:
                assert taken == tapped[-1]
            else:
                assert taken == (held[-1] if held else "stay")
                fresh.discard(taken)
            tapped.clear()
