"""Listening to the health of a deployment's services, and judging it together with what supervisord says."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from schemas import Health, MalformedMessage
from vantage.bus import Bus, Event, Sample
from vantage.deployment import Deployment, Process
from vantage.printable import printable
from vantage.service import bad_messages

STALE_HEALTH = 2.5
"""Seconds without a health message, due each second, after which a service is silent."""
TROUBLESOME_RESTARTS = 3
"""A service that was started so often before it was ever healthy does not start at all."""
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
            "bad": bad_messages(health) if health else 0,
        }


def judge(process: Process, health: Health | None, age: float) -> Verdict:
    """Return the verdict on a service.

    Args:
        health: its last message, of this process or an earlier one.
        age: s since that message arrived, on the listener's own monotonic clock: stamps are of the service's clock, from which a
            suspended machine or a corrected wall clock differs.
    """
    if process.state not in _ALIVE:
        return Verdict(False, process.state.lower(), printable(process.complaint) or "no process", process, None)
    if health is None or health.process != process.pid:
        return Verdict(False, "starting", "has not reported yet", process, None)
    if age > STALE_HEALTH:
        trouble = f"silent: health/{process.name} is {age:.1f} s old, expected 1 a second"
        return Verdict(False, "silent", trouble, process, health)
    stale = [entry.key for entry in health.inputs if entry.stale]
    if health.state == "ok" and not stale:
        return Verdict(True, "ok", "", process, health)
    trouble = printable(health.reason) or f"stale inputs: {printable(', '.join(stale))}"
    return Verdict(False, health.state, trouble, process, health)


def diagnosis(deployment: Deployment, verdicts: Sequence[Verdict]) -> str:
    """Return why services are not healthy, each by its own last words where it could not start; empty if all are."""
    sick = [verdict for verdict in verdicts if not verdict.healthy]
    # Those that live only complain that the dead ones are missing.
    dead = [verdict for verdict in sick if verdict.health is None]
    return "\n".join(_diagnosis_of(deployment, verdict) for verdict in dead or sick)


def _diagnosis_of(deployment: Deployment, verdict: Verdict) -> str:
    name = printable(verdict.process.name)
    tail = deployment.tail(name) or "(it printed nothing)"
    last = tail.splitlines()[-1]
    if last.startswith(f"{name} cannot start: "):
        return last
    indented = "\n".join(f"    {line}" for line in tail.splitlines())
    trouble = printable(verdict.trouble)
    return f"{name}: {verdict.state}: {trouble}\n  the end of {deployment.folder / (name + '.log')}:\n{indented}"


def _is_hopeless(verdict: Verdict) -> bool:
    """Return whether more patience will not make a service healthy."""
    process = verdict.process
    never_starts = process.state == "FATAL" or "find command" in process.complaint
    return not verdict.healthy and (never_starts or process.restarts >= TROUBLESOME_RESTARTS)


@dataclass
class HealthWatch:
    """Collects `health/*` from a deployment's bus. A listener of any name: several may watch at once."""

    deployment: Deployment
    arena: str = "table"
    _last: dict[str, tuple[Health, float]] = field(default_factory=dict)
    _bus: Bus | None = None
    _listened_until: float = 0.0

    def __enter__(self) -> HealthWatch:
        # Zenoh is imported late: other commands of `vantage` must not wait for it.
        from vantage.bus.zenoh_bus import ZenohBus

        self._bus = ZenohBus(f"watch-{os.getpid()}", self.deployment.folder, self.arena)
        self._bus.subscribe("health/*")
        self._listened_until = time.monotonic()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bus is not None:
            self._bus.close()

    def listen(self, seconds: float) -> None:
        """Take in what is published during `seconds`."""
        assert self._bus is not None
        # What waits already may have come at any time since the last call.
        while (event := self._bus.receive(0.0)) is not None:
            self._take(event, self._listened_until)
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self._take(self._bus.receive(left), time.monotonic())
        self._listened_until = time.monotonic()

    def _take(self, event: Event | None, heard: float) -> None:
        if not isinstance(event, Sample):
            return
        try:
            message = event.decode()
        except MalformedMessage:
            return
        if isinstance(message, Health) and event.publisher == message.service and event.key == f"health/{message.service}":
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

    def wait_until_healthy(
        self, patience: float, show: Callable[[Sequence[Verdict]], None] = lambda verdicts: None
    ) -> list[Verdict]:
        """Return the verdicts once all services are healthy, one of them will not start, or `patience` seconds are over.

        Args:
            show: is called with the verdicts meanwhile.

        Raises:
            DeploymentError: the deployment is not up.
        """
        deadline = time.monotonic() + patience
        while True:
            self.listen(0.1)
            verdicts = self.verdicts()
            show(verdicts)
            settled = all(verdict.healthy for verdict in verdicts) or any(_is_hopeless(verdict) for verdict in verdicts)
            if settled or time.monotonic() > deadline:
                return verdicts
