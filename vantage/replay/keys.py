"""Keys of a terminal, while a replay plays in it."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator

MEANINGS = {
    " ": "pause",
    "\x1b[D": "back",
    "\x1b[C": "forward",
    "\x1b[A": "faster",
    "\x1b[B": "slower",
    "\x1bOD": "back",
    "\x1bOC": "forward",
    "\x1bOA": "faster",
    "\x1bOB": "slower",
    "n": "next",
    "p": "previous",
    "q": "quit",
}
"""What a key sends -> what it means; arrows in both modes that terminals have."""
BACKGROUND_PERIOD = 0.2
"""Seconds between two looks whether a replay in the background came back."""
HELP = "space pause, ←/→ 5 s, ↑/↓ speed, n/p next/previous game, q quit"


def wishes_in(text: str) -> list[str]:
    """Return what the keys of `text` mean, in order; what means nothing is passed over."""
    found = []
    at = 0
    while at < len(text):
        length = 3 if text.startswith(("\x1b[", "\x1bO"), at) else 1
        meaning = MEANINGS.get(text[at : at + length].lower() if length == 1 else text[at : at + length])
        if meaning is not None:
            found.append(meaning)
        at += length
    return found


@contextlib.contextmanager
def keyboard(post: Callable[[str], None]) -> Iterator[bool]:
    """While it lasts, call `post` with the meaning of each key typed, from a thread; yields whether there is a keyboard.

    A replay in the background (`vantage replay LOG &`) has none: the terminal's keys are the shell's, and the kernel stops who
    touches it all the same.
    """
    if not sys.stdin.isatty() or _in_background(sys.stdin.fileno()):
        yield False
        return
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    stopping, wake = os.pipe()

    def listen() -> None:
        while True:
            readable, _, _ = select.select([descriptor, stopping], [], [])
            if stopping in readable:
                return
            if _in_background(descriptor):  # put there by Ctrl-Z and `bg`
                select.select([stopping], [], [], BACKGROUND_PERIOD)
                continue
            data = os.read(descriptor, 64)
            if not data:
                return
            for wish in wishes_in(data.decode(errors="replace")):
                post(wish)

    thread = threading.Thread(target=listen, name="keyboard", daemon=True)
    try:
        tty.setcbreak(descriptor)
        thread.start()
        yield True
    finally:
        os.write(wake, b"x")
        thread.join(1.0)
        os.close(wake)
        os.close(stopping)
        if not _in_background(descriptor):
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _in_background(descriptor: int) -> bool:
    try:
        return os.tcgetpgrp(descriptor) != os.getpgrp()
    except OSError:
        return False  # a terminal, but not the one that this process is controlled from: nobody else reads it
