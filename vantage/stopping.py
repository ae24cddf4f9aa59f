"""How a command stops: on Ctrl-C, SIGTERM or a closed terminal, within two seconds, with one line on what is kept.

The first signal raises `KeyboardInterrupt` in the main thread, so that `with` and `finally` blocks clean up. A thread watches:
a command that has not ended `GRACE` seconds later (it sits in a compiled kernel, or waits for a pool) is ended there and then.
That is safe because results get their final names only when they are complete (`vantage.output`).
"""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

GRACE = 1.5
"""Seconds between the signal and the end by force."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PR_SET_PDEATHSIG = 1

_deferrals = 0
_requested = 0
"""Number of the signal that asked this process to stop, 0 while none has."""


def stop_requested() -> bool:
    """Return whether a signal has asked this process to stop; for loops inside `stop_deferred`."""
    return _requested != 0


@contextmanager
def stop_deferred() -> Iterator[None]:
    """Within, a signal only makes `stop_requested` true: for a loop that must end between two steps.

    The loop then raises KeyboardInterrupt itself, once it has written what it keeps. Only for code in the main thread.
    """
    global _deferrals
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {
        number: signal.signal(number, _on_signal) for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN
    }
    _deferrals += 1
    try:
        yield
    finally:
        _deferrals -= 1
        for number, handler in previous.items():
            signal.signal(number, handler)


def follow_parent() -> None:
    """Make this worker process leave signals of the terminal to its parent, and end when the parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal_on_parent_death(signal.SIGKILL)


def signal_on_parent_death(number: signal.Signals) -> None:
    """Make the kernel send this process a signal when its parent ends, however that ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


def run_stoppable(function: Callable[[], int], name: str, kept: str = "") -> int:
    """Run a command in the main thread and return its exit code: 128 + the signal's number when it was stopped.

    Args:
        function: the command; `KeyboardInterrupt` leaves it. One that the command itself raises (see `stop_deferred`) may carry
            a text that takes the place of `kept`.
        name: the command as it was typed, which begins the line.
        kept: what is kept and how to go on, for that line.
    """
    with _ended_by_force(name, kept) as end:
        try:
            return function()
        except KeyboardInterrupt as stopped:
            end.say(str(stopped))
            return 128 + (_requested or signal.SIGINT)


class _End:
    """The line that a stopped command ends with, printed once by whoever comes first."""

    def __init__(self, name: str, kept: str) -> None:
        self._name, self._kept = name, kept
        self._said = threading.Lock()

    def say(self, kept: str = "") -> None:
        if not self._said.acquire(blocking=False):
            return
        kept = kept or self._kept
        line = f"{self._name}: stopped" + (f"; {kept}" if kept else "")
        # A progress display that was cut off has hidden the cursor.
        show_cursor = "\r\x1b[K\x1b[?25h" if os.isatty(2) else ""
        os.write(2, f"{show_cursor}{line}\n".encode(errors="replace"))


def _on_signal(number: int, _frame: FrameType | None) -> None:
    global _requested
    first, _requested = _requested == 0, number
    if first and not _deferrals:
        raise KeyboardInterrupt


@contextmanager
def _ended_by_force(name: str, kept: str) -> Iterator[_End]:
    """Install the signals' handlers and the thread that ends a command which does not end by itself."""
    global _requested
    _requested = 0
    end = _End(name, kept)
    awake, alarm = socket.socketpair()
    alarm.setblocking(False)
    previous_alarm = signal.set_wakeup_fd(alarm.fileno(), warn_on_full_buffer=False)
    previous = {
        number: signal.signal(number, _on_signal) for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN
    }

    def watch() -> None:
        try:
            while (received := awake.recv(1)) and received[0] not in _SIGNALS:
                pass
            if received and not ended.wait(GRACE):
                end.say()
                os._exit(128 + received[0])
        except OSError:
            return  # closed: the command is over

    ended = threading.Event()
    watcher = threading.Thread(target=watch, name="stopping", daemon=True)
    watcher.start()
    try:
        yield end
    finally:
        if not _requested:  # else the watch goes on: threads and children may still hold the interpreter up
            ended.set()
            signal.set_wakeup_fd(previous_alarm)
            for number, handler in previous.items():
                signal.signal(number, handler)
            alarm.close()
            watcher.join()
            awake.close()
