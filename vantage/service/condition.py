"""The condition of a service: what it has heard, lost and set aside, who is alive, and what health says of it."""

from __future__ import annotations

import logging
import os
from collections import deque
from dataclasses import dataclass

from schemas import TOPICS, Health, InputHealth, MalformedMessage
from vantage.cores import available_cores
from vantage.printable import counted, printable, shortened
from vantage.service.core import SECOND, Core

STALE_PERIODS = 10
STALE_MINIMUM = 2.5
"""An input is stale in a running real-time game when it is older than 10 of its periods, and than 2.5 s, pauses not counted."""

logger = logging.getLogger("vantage")

TROUBLE_LASTS = 10 * SECOND
"""ns that health repeats what went wrong with one message, and that a service is degraded after it failed to handle one."""
LOG_PERIOD = SECOND
"""ns between lines of the log about bad messages; those between are counted."""

TOO_SLOW = "this machine is too slow"
"""With this the reason begins where a service cannot keep its times for want of cores; others then wait longer for it."""
LATEST = SECOND // 2
"""ns by which a service may be woken late before the machine is too slow."""
LATE_OVER, LATE_TIMES = 10 * SECOND, 3
"""ns within which it must have been woken late so often: one delay is a process that was stopped, or a machine that slept."""

MOST_INPUTS = 200
"""Keys that health tells apart; a raw service counts further ones together, as `**`."""


@dataclass(slots=True)
class InputCounts:
    """Running counts of one input; `last` is when it was heard last, ns."""

    publisher: str = ""
    received: int = 0
    malformed: int = 0
    lost: int = 0
    last: int | None = None


def load_text() -> str:
    """Return how many processes want a core now, and how many cores there are."""
    cores = available_cores()
    return f"load {os.getloadavg()[0]:.1f} on {counted(cores, 'core')}"


class Condition:
    """See module. All times in ns since the Unix epoch.

    Attributes:
        unexpected: well-formed messages that made no sense and were set aside.
        failed: messages whose handling raised an error.
        trouble: what went wrong with a message last.
    """

    def __init__(self, core: Core, now: int) -> None:
        self.unexpected = 0
        self.failed = 0
        self.trouble = ""
        self._core = core
        self._inputs = {} if core.declaration.raw else {key: InputCounts() for key in core.declaration.inputs}
        self._alive: dict[str, bool] = {}
        self._troubled_at = 0
        self._failure = ""
        self._failed_at = 0
        self._logged_at: int | None = None
        self._unlogged = 0
        self._flowing_since: int | None = None
        self._delays: deque[tuple[int, int]] = deque(maxlen=64)  # when it was woken late, and how late, ns
        self._started = now

    def counts_of(self, key: str, publisher: str = "") -> InputCounts:
        """Return the counts of a key; `publisher` of one that nothing was heard of."""
        counts = self._inputs.get(key)
        if counts is None:
            # Strangers may publish on any number of keys; health stays small.
            if key not in TOPICS and len(self._inputs) >= MOST_INPUTS:
                key = "**"
            counts = self._inputs.setdefault(key[:200], InputCounts(publisher=publisher))
        return counts

    def malformed(self, key: str, publisher: str, error: MalformedMessage, now: int) -> None:
        """Count a message that does not decode."""
        self.counts_of(key).malformed += 1
        self._note(f"{key} from {publisher or 'an unknown publisher'} was malformed: {error}", now)

    def set_aside(self, text: str, now: int) -> None:
        """Count a well-formed message that makes no sense."""
        self.unexpected += 1
        self._note(f"set aside: {text}", now)

    def fail(self, text: str, now: int) -> None:
        """Count a message whose handling raised an error: the service is degraded for a while."""
        self.failed += 1
        self.trouble = self._failure = printable(text)
        self._troubled_at = self._failed_at = now

    def _note(self, trouble: str, now: int) -> None:
        """Keep what is wrong with a message for health, and log it unless another one was logged just now."""
        self.trouble, self._troubled_at = printable(trouble), now
        if self._logged_at is not None and 0 <= now - self._logged_at < LOG_PERIOD:
            self._unlogged += 1
            return
        more = f" (and {self._unlogged} more bad messages before it)" if self._unlogged else ""
        logger.warning("%s%s", self.trouble, more)
        self._logged_at, self._unlogged = now, 0

    def woken(self, late: int, now: int) -> None:
        """The service got a core `late` ns after it wanted one (below 0: it was in time)."""
        if late > LATEST:
            self._delays.append((now, late))

    def hears_of(self, name: str, alive: bool) -> bool:
        """A service came or went; return whether that is news."""
        news = self._alive.get(name) != alive
        self._alive[name] = alive
        return news

    def expects_flow(self, flowing: bool, now: int) -> None:
        """Inputs that have a rate come at it from now on, or need not come."""
        if not flowing:
            self._flowing_since = None
        elif self._flowing_since is None:
            self._flowing_since = now

    def report(self, state: str, now: int) -> Health:
        """Return the health report.

        Args:
            state: `ok` becomes `degraded` where something is wrong.
        """
        declaration = self._core.declaration
        troubles = [
            f"{names.replace('|', ' or ')} is not alive"
            for names in sorted(declaration.heeds)
            if not any(self._alive.get(name, False) for name in names.split("|"))
        ]
        delays = [late for at, late in self._delays if now - at < LATE_OVER]
        if len(delays) >= LATE_TIMES:
            worst = f"{max(delays) / SECOND:.1f} s late {len(delays)} times in {LATE_OVER // SECOND} s"
            troubles.append(f"{TOO_SLOW}: {declaration.name} ran up to {worst}")
        if own := getattr(self._core, "trouble", ""):
            troubles.append(own)
        if any(TOO_SLOW in trouble for trouble in troubles):
            troubles.append(f"{load_text()}: stop other programs")
        if self._failure and now - self._failed_at < TROUBLE_LASTS:
            troubles.append(self._failure)
        inputs = []
        for key, counts in self._inputs.items():
            age = None if counts.last is None else max(0.0, (now - counts.last) / SECOND)
            rate = TOPICS[key].rate if key in TOPICS else 0.0
            stale = rate > 0 and not key.startswith("health/") and self._is_stale(counts.last, rate, now)
            if stale:
                troubles.append(f"{key} from {counts.publisher or 'nobody'} is {age:.1f} s old, expected {rate:g} a second")
            inputs.append(
                InputHealth(
                    key=key,
                    publisher=counts.publisher,
                    received=counts.received,
                    malformed=counts.malformed,
                    lost=counts.lost,
                    age=age,
                    stale=stale,
                )
            )
        if troubles and state == "ok":
            state = "degraded"
        recent = self.trouble and self.trouble not in troubles and now - self._troubled_at < TROUBLE_LASTS
        reason = "; ".join([*troubles, self.trouble] if recent else troubles)
        return Health(
            stamp=now,
            service=declaration.name,
            state=state,  # type: ignore[arg-type]
            process=os.getpid(),
            uptime=max(0.0, (now - self._started) / SECOND),
            inputs=tuple(inputs[:256]),
            unexpected=self.unexpected,
            failed=self.failed,
            reason=shortened(reason, 2000),
        )

    def _is_stale(self, last: int | None, rate: float, now: int) -> bool:
        """Whether an input that flows while a game runs has failed to: neither before the game, nor during a pause."""
        if last is None or self._flowing_since is None:
            return False
        return now - max(last, self._flowing_since) > SECOND * max(STALE_PERIODS / rate, STALE_MINIMUM)


def bad_messages(health: Health) -> int:
    """Return how many messages a service could not use: malformed, set aside, or failed to be handled."""
    return sum(each.malformed for each in health.inputs) + health.unexpected + health.failed
