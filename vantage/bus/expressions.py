"""Key expressions: which keys a subscription names."""

from __future__ import annotations

from collections.abc import Iterable


def check(expression: str) -> None:
    """Refuse what is not a key expression of the bus: chunks between `/`, each plain, `*` (one chunk) or `**` (any number).

    Raises:
        ValueError: an empty chunk, a character with a meaning of its own in Zenoh (`@ # ? $`), or `*` beside other characters.
    """
    for chunk in expression.split("/"):
        if not chunk:
            raise ValueError(f"key expression {expression!r} has an empty chunk: write `hider/pose`, without `/` at the ends")
        if any(sign in chunk for sign in "@#?$") or ("*" in chunk and chunk not in ("*", "**")):
            raise ValueError(f"key expression {expression!r}: chunk {chunk!r} must be plain, `*` or `**`")


def matches(expression: str, key: str) -> bool:
    """Return whether `key` is named by `expression`, with Zenoh's rules for `*` and `**`."""
    return _matches(expression.split("/"), key.split("/"))


def _matches(pattern: list[str], chunks: list[str]) -> bool:
    if not pattern:
        return not chunks
    if pattern[0] == "**":
        return any(_matches(pattern[1:], chunks[skip:]) for skip in range(len(chunks) + 1))
    return bool(chunks) and pattern[0] in ("*", chunks[0]) and _matches(pattern[1:], chunks[1:])


def named_keys(expression: str, keys: Iterable[str]) -> list[str]:
    """Return those of `keys` that `expression` names, in their order."""
    check(expression)
    return [key for key in keys if matches(expression, key)]
