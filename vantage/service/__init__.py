"""What a service is: a pure core that declares what it hears and says, and the runtime that puts it on a bus.

A core has no clock, no bus and no I/O: `step` turns one received event and the time into what is to be sent. The runtime
decodes at the door, counts what was malformed, lost or unexpected, reports health once a second and stops on SIGTERM.
"""

from vantage.service.condition import TOO_SLOW, bad_messages, load_text
from vantage.service.core import (
    SECOND,
    Answer,
    Answered,
    Arrived,
    Ask,
    Asked,
    CannotStart,
    Changed,
    Core,
    Declaration,
    Publish,
    Received,
    Refuse,
    Send,
    Unexpected,
    Woken,
)
from vantage.service.device import Captured, Device, DeviceLost, Write
from vantage.service.in_process import run_in_process
from vantage.service.join import StepJoin
from vantage.service.process import BusSettings, run
from vantage.service.runtime import Runtime, steady_clock
from vantage.service.sender_clock import SenderClock

__all__ = [
    "SECOND",
    "TOO_SLOW",
    "Answer",
    "Answered",
    "Arrived",
    "Ask",
    "Asked",
    "BusSettings",
    "CannotStart",
    "Captured",
    "Changed",
    "Core",
    "Declaration",
    "Device",
    "DeviceLost",
    "Publish",
    "Received",
    "Refuse",
    "Runtime",
    "Send",
    "SenderClock",
    "StepJoin",
    "Unexpected",
    "Woken",
    "Write",
    "bad_messages",
    "load_text",
    "run",
    "run_in_process",
    "steady_clock",
]
