"""Listening to the health of a deployment's services, and judging it together with what supervisord says."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field

from schemas import Health, MalformedMessage
from vantage.bus import Bus, Sample
from vantage.deployment import Deployment, Process

STALE_HEALTH = 2.5
"""Seconds after which a health message, due each second, is no news any more."""
_ALIVE = ("STARTING", "RUNNING")


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a service does.

    Attributes:
        healthy: its process lives, says `ok`, said so lately, and no input is stale.
        state: one word for people.
        trouble: what is wrong, empty when healthy.
        process: what supervisord says of it.
        health: what it says of itself, None when it is silent.
    """

    healthy: bool
    state: str
    trouble: str
    process: Process
    health: Health | None

    def as_dict(self) -> dict[str, object]:
        """Return what `vantage status --json` prints of it."""
        health = self.health
        return {
            "service": self.process.name,
            "healthy": self.healthy,
            "state": self.state,
            "trouble": self.trouble,
            "pid": self.process.pid,
            "restarts": self.process.restarts,
            "uptime_seconds": self.process.uptime,
            "memory_bytes": self.process.memory,
            "stale_inputs": [entry.key for entry in health.inputs if entry.stale] if health else [],
            "malformed": sum(entry.malformed for entry in health.inputs) if health else 0,
            "lost": sum(entry.lost for entry in health.inputs) if health else 0,
            "unexpected": health.unexpected if health else 0,
            "failed": health.failed if health else 0,
        }


def judge(process: Process, health: Health | None, age: float) -> Verdict:
    """Return the verdict on a service.

    Args:
        health: its last message, of this process or an earlier one.
        age: s since that message came.
    """
    if process.state not in _ALIVE:
        return Verdict(False, process.state.lower(), process.complaint or "no process", process, None)
    if health is None or health.process != process.pid:
        return Verdict(False, "starting", "has not reported yet", process, None)
    if age > STALE_HEALTH:
        trouble = f"silent: health/{process.name} is {age:.1f} s old, expected 1 a second"
        return Verdict(False, "silent", trouble, process, health)
    stale = [entry.key for entry in health.inputs if entry.stale]
    if health.state == "ok" and not stale:
        return Verdict(True, "ok", "", process, health)
    return Verdict(False, health.state, health.reason or f"stale inputs: {', '.join(stale)}", process, health)


@dataclass
class HealthWatch:
    """Collects `health/*` from a deployment's bus. A listener of any name: several may watch at once."""

    deployment: Deployment
    arena: str = "table"
    _last: dict[str, tuple[Health, float]] = field(default_factory=dict)
    _bus: Bus | None = None

    def __enter__(self) -> HealthWatch:
        # Zenoh is imported late: other commands of `vantage` must not wait for it.
        from vantage.bus.zenoh_bus import ZenohBus

        self._bus = ZenohBus(f"watch-{os.getpid()}", self.deployment.folder, self.arena)
        self._bus.subscribe("health/*")
        return self

    def __exit__(self, *_: object) -> None:
        if self._bus is not None:
            self._bus.close()

    def listen(self, seconds: float) -> None:
        """Take in what is said during `seconds`."""
        assert self._bus is not None
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            event = self._bus.receive(left)
            if isinstance(event, Sample):
                try:
                    message = event.decode()
                except MalformedMessage:
                    continue
                if (
                    isinstance(message, Health)
                    and event.publisher == message.service
                    and event.key == f"health/{message.service}"
                ):
                    heard = time.monotonic() - max(0.0, (time.time_ns() - message.stamp) / 1e9)
                    self._last[message.service] = (message, heard)

    def verdicts(self) -> list[Verdict]:
        """Return the verdict on every service of the deployment.

        Raises:
            DeploymentError: the deployment is not up.
        """
        now = time.monotonic()
        verdicts = []
        for process in self.deployment.processes():
            health, heard = self._last.get(process.name, (None, 0.0))
            verdicts.append(judge(process, health, now - heard))
        return verdicts
