"""Text for people: what somebody else wrote is made safe to print, numbers agree with their nouns."""

from __future__ import annotations

import unicodedata

_NOT_PRINTED = frozenset(("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"))


def counted(count: int, noun: str) -> str:
    """Return a number with its noun: "1 message", "2 messages"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def shortened(text: str, longest: int) -> str:
    """Return text of at most `longest` characters: what is longer ends between two words, with an ellipsis."""
    if len(text) <= longest:
        return text
    kept = text[:longest]
    end = kept.rfind(" ")
    # One long word (a path) is cut within.
    kept = kept[:end] if end > longest // 2 else kept[:-1]
    return kept.rstrip(" ,;:") + "…"


def printable(text: str, longest: int = 2000) -> str:
    """Return text without anything that a terminal obeys: control codes, escape sequences, changes of direction.

    Line breaks and tabs become spaces. Rich markup is not text of this kind: pass the result in a `rich.text.Text`, or through
    `rich.markup.escape`.

    Args:
        longest: characters; see `shortened`.
    """
    text = shortened(text, longest)
    spaced = (" " if letter in "\n\r\t" else letter for letter in text)
    return "".join(letter for letter in spaced if unicodedata.category(letter) not in _NOT_PRINTED)
