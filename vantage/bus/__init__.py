"""The message bus: one interface, in-process and over Zenoh (`vantage.bus.zenoh_bus`, loaded only by processes on a real bus)."""

from vantage.bus.in_process import InProcessBus, InProcessNetwork, VirtualClock
from vantage.bus.interface import (
    Alive,
    Bus,
    CallFailed,
    CannotOpen,
    Event,
    Lost,
    NameInUse,
    NotPublisher,
    Refused,
    Reply,
    Request,
    Sample,
    UndeclaredKey,
    WrongType,
)

__all__ = [
    "Alive",
    "Bus",
    "CallFailed",
    "CannotOpen",
    "Event",
    "InProcessBus",
    "InProcessNetwork",
    "Lost",
    "NameInUse",
    "NotPublisher",
    "Refused",
    "Reply",
    "Request",
    "Sample",
    "UndeclaredKey",
    "VirtualClock",
    "WrongType",
]
