"""Services in one thread, in virtual time: the same games as in separate processes, faster than the clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from vantage.bus import InProcessNetwork, VirtualClock
from vantage.service.runtime import Runtime


def run_in_process(network: InProcessNetwork, runtimes: Sequence[Runtime], until: Callable[[], bool]) -> None:
    """Run services in one thread, each in turn, deterministically, until `until()` is true.

    When nobody has anything to do, the network's clock (a VirtualClock) jumps to the next time that a core wants to be woken or
    a call is due.

    Raises:
        RuntimeError: nothing is left to do although `until()` is false.
    """
    clock = network.clock
    assert isinstance(clock, VirtualClock)
    while not until():
        active = False
        for runtime in runtimes:
            active |= runtime.drain()
        if not active:
            wakes = [runtime.core.wake_at() for runtime in runtimes] + [network.next_deadline()]
            due = [wake for wake in wakes if wake is not None]
            if not due:
                raise RuntimeError("the services are all idle, and what was waited for has not come")
            clock.now = max(clock.now, min(due))
