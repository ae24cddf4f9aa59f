"""Our matching of key expressions is Zenoh's."""

import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st

from vantage.bus.expressions import matches, named_keys

chunks = st.sampled_from(["a", "b", "pose"])
keys = st.lists(chunks, min_size=1, max_size=5).map("/".join)
expressions = st.lists(chunks | st.sampled_from(["*", "**"]), min_size=1, max_size=5).map("/".join)


@settings(deadline=None)
@given(expressions, keys)
def test_matches_what_zenoh_matches(expression: str, key: str) -> None:
    assert matches(expression, key) == zenoh.KeyExpr.autocanonize(expression).includes(zenoh.KeyExpr(key))


@settings(deadline=None)
@given(expressions, st.lists(keys, unique=True))
def test_named_keys_keep_their_order(expression: str, declared: list[str]) -> None:
    assert named_keys(expression, declared) == [key for key in declared if matches(expression, key)]
