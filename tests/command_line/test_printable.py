"""Strangers' text cannot move a terminal's cursor, change its direction or fill its screen."""

from vantage.printable import printable


def test_codes_are_gone_and_letters_are_kept() -> None:
    assert printable("a\x1b[31mb\x07\x9b2J\u202ec\u2066d") == "a[31mb2Jcd"
    assert printable("Grüße, 日本, Ω") == "Grüße, 日本, Ω"


def test_lines_become_one_line_of_bounded_length() -> None:
    assert printable("a\nb\tc\rd") == "a b c d"
    assert printable("x" * 100, longest=10) == "x" * 9 + "…"
