"""What the services say of themselves, and who has gone silent."""

from __future__ import annotations

from schemas import Gap, Health
from services.console.frames import frame
from vantage.service import SECOND, bad_messages

SILENCE = 5 * SECOND // 2
"""ns after which a service that says something every second is judged silent."""


class Reports:
    """The latest health of each service, by the time of its arrival."""

    def __init__(self) -> None:
        self._heard: dict[str, tuple[Health, int]] = {}
        self._missed = 0

    def add(self, health: Health, now: int) -> None:
        self._heard[health.service] = health, now

    def miss(self, gap: Gap) -> None:
        """Take in the recorder's note that messages are missing."""
        self._missed += gap.missed

    def is_silent(self, service: str, now: int) -> bool:
        """Return whether a service has said nothing lately, or never."""
        heard = self._heard.get(service)
        return heard is None or now - heard[1] > SILENCE

    def frame(self, now: int) -> bytes:
        """Return the frame `services`."""
        rows = []
        for service, (health, heard_at) in sorted(self._heard.items()):
            silent = self.is_silent(service, now)
            age = max(0.0, (now - heard_at) / SECOND)
            rows.append(
                {
                    "service": service,
                    "state": "silent" if silent else health.state,
                    "reason": f"said nothing for {age:.0f} s" if silent else health.reason,
                    "age": age,
                    "uptime": health.uptime,
                    "lost": sum(each.lost for each in health.inputs),
                    "bad": bad_messages(health),
                }
            )
        return frame("services", {"services": rows})

    def recording(self, now: int) -> bytes:
        """Return the frame `recording`."""
        heard = self._heard.get("recorder")
        if heard is None or heard[0].state == "stopping":
            state, reason = "off", "the recorder is not running"
        elif self.is_silent("recorder", now):
            state, reason = "trouble", f"nothing heard of the recorder for {(now - heard[1]) / SECOND:.0f} s"
        elif heard[0].state == "degraded":
            state, reason = "trouble", heard[0].reason
        else:
            state, reason = "on", ""
        return frame("recording", {"state": state, "reason": reason, "lost": self._missed})
