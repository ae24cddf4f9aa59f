"""Whole games in one thread: the real cores on the in-process bus under a virtual clock, everything logged."""

from __future__ import annotations

from collections.abc import Mapping

from schemas import Episode
from vantage.bus import InProcessNetwork, Sample, VirtualClock
from vantage.log import LogWriter
from vantage.service import Core, Runtime, run_in_process


def play(cores: Mapping[str, Core], games: int, start: int, writer: LogWriter) -> int:
    """Play until enough games have ended (or were aborted). Returns the number of steps played.

    Args:
        cores: participant's name -> core; the referee among them, set to start the games by itself.
        start: ns since the Unix epoch at which the virtual clock starts.
        games: how many.
        writer: takes every message, as the recorder would.

    Raises:
        OSError: the writer's disk refuses.
    """
    network = InProcessNetwork(clock=VirtualClock(start))
    recorder = network.session("recorder")
    recorder.subscribe("**", raw=True)
    runtimes = [Runtime(core, network.session(name), network.clock, health=False) for name, core in cores.items()]
    ended = steps = 0

    def record() -> bool:
        nonlocal ended, steps
        while (event := recorder.receive(0.0)) is not None:
            if not isinstance(event, Sample):
                continue
            writer.write(
                event.key,
                event.payload,
                log_time=event.published,
                publish_time=event.published,
                sequence=event.sequence,
                publisher=event.publisher,
            )
            if event.key == "tick":
                steps += 1
            elif event.key == "episode":
                message = event.decode()
                ended += isinstance(message, Episode) and message.phase in ("ended", "aborted")
        return ended >= games

    run_in_process(network, runtimes, record)
    return steps
