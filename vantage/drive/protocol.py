"""Lines that travel over a robot's serial line (115200 baud, 8N1), both ways; see docs/robot-protocol.md.

A line is `$<letter>,<sequence>[,<number>...]*<checksum>\\n` in ASCII: numbers are decimal integers without leading zeros,
the checksum is CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF) of what stands between `$` and `*`, as four
upper-case hexadecimal digits. What does not read exactly like that is damaged: it is refused and counted.
"""

from __future__ import annotations

import binascii
import re
from dataclasses import astuple, dataclass, field
from typing import ClassVar

BAUD = 115_200
WATCHDOG = 0.3
"""Seconds without a good line after which a robot stops its wheels."""
TELEMETRY_RATE = 50.0
"""Telemetry lines a second."""
SEQUENCES = 65_536
"""Sequence numbers count modulo this."""
LONGEST = 80
"""Bytes of a line at most, with its end."""
SPEED_LIMIT = 2000
"""mm/s of a wheel at most."""

EMERGENCY_STOP = 1
"""Flag: latched by the button or by a line; wheels stand still until it is cleared."""
LOW_BATTERY = 2
"""Flag: charge the battery."""
WATCHDOG_STOP = 4
"""Flag: wheels were stopped because no good line came in time."""
BUTTON = 8
"""Flag: the emergency stop button is pressed now, so that the latch cannot be cleared."""


class DamagedLine(ValueError):
    """The bytes are not a line of the protocol, exactly as it is written."""


@dataclass(frozen=True, slots=True)
class SetSpeeds:
    """Turn the wheels at these speeds, mm/s, forwards positive, until the next such line or the watchdog."""

    letter: ClassVar[str] = "S"
    ranges: ClassVar[tuple[tuple[int, int], ...]] = ((0, SEQUENCES - 1), (-SPEED_LIMIT, SPEED_LIMIT), (-SPEED_LIMIT, SPEED_LIMIT))
    sequence: int
    left: int
    right: int


@dataclass(frozen=True, slots=True)
class Stop:
    """Stop the wheels."""

    letter: ClassVar[str] = "H"
    ranges: ClassVar[tuple[tuple[int, int], ...]] = ((0, SEQUENCES - 1),)
    sequence: int


@dataclass(frozen=True, slots=True)
class EmergencyStop:
    """Stop the wheels and refuse to turn them until `ClearEmergencyStop`."""

    letter: ClassVar[str] = "E"
    ranges: ClassVar[tuple[tuple[int, int], ...]] = ((0, SEQUENCES - 1),)
    sequence: int


@dataclass(frozen=True, slots=True)
class ClearEmergencyStop:
    """Let the wheels turn again; without effect while the button is pressed."""

    letter: ClassVar[str] = "C"
    ranges: ClassVar[tuple[tuple[int, int], ...]] = ((0, SEQUENCES - 1),)
    sequence: int


@dataclass(frozen=True, slots=True)
class Query:
    """Answer; wheels and watchdog are left alone."""

    letter: ClassVar[str] = "Q"
    ranges: ClassVar[tuple[tuple[int, int], ...]] = ((0, SEQUENCES - 1),)
    sequence: int


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """The robot took the line of this sequence number; its flags after it."""

    letter: ClassVar[str] = "A"
    ranges: ClassVar[tuple[tuple[int, int], ...]] = ((0, SEQUENCES - 1), (0, 255))
    sequence: int
    flags: int


@dataclass(frozen=True, slots=True)
class Telemetry:
    """What the robot measures, `TELEMETRY_RATE` times a second, with a sequence number of its own.

    Attributes:
        milliseconds: robot's clock at the measurement, modulo 2**32.
        taken: sequence number of the last line it took before that.
        left, right: encoder ticks since it was switched on, forwards positive, two's complement of 32 bits.
        battery: mV.
        flags: EMERGENCY_STOP | LOW_BATTERY | WATCHDOG_STOP | BUTTON.
    """

    letter: ClassVar[str] = "T"
    ranges: ClassVar[tuple[tuple[int, int], ...]] = (
        (0, SEQUENCES - 1),
        (0, 2**32 - 1),
        (0, SEQUENCES - 1),
        (-(2**31), 2**31 - 1),
        (-(2**31), 2**31 - 1),
        (0, 65_535),
        (0, 255),
    )
    sequence: int
    milliseconds: int
    taken: int
    left: int
    right: int
    battery: int
    flags: int


ToRobot = SetSpeeds | Stop | EmergencyStop | ClearEmergencyStop | Query
FromRobot = Acknowledgement | Telemetry
Line = ToRobot | FromRobot

_KINDS: dict[str, type[Line]] = {
    kind.letter: kind for kind in (SetSpeeds, Stop, EmergencyStop, ClearEmergencyStop, Query, Acknowledgement, Telemetry)
}
_SHAPE = re.compile(rb"\$(([A-Z])((?:,(?:0|-?[1-9][0-9]{0,9}))+))\*([0-9A-F]{4})\n")


def checksum(body: bytes) -> int:
    """Return CRC-16/CCITT-FALSE of what stands between `$` and `*`."""
    return binascii.crc_hqx(body, 0xFFFF)


def encode(line: Line) -> bytes:
    """Return the bytes of a line, its end included.

    Raises:
        ValueError: a number is out of range.
    """
    numbers: tuple[int, ...] = astuple(line)
    for number, (low, high) in zip(numbers, line.ranges, strict=True):
        if not low <= number <= high:
            raise ValueError(f"{type(line).__name__}: {number} lies outside {low} .. {high}")
    body = ",".join((line.letter, *map(str, numbers))).encode()
    return b"$%b*%04X\n" % (body, checksum(body))


def decode(data: bytes) -> Line:
    """Return the line that the bytes (its end included) are.

    Raises:
        DamagedLine: they are not exactly a line of the protocol.
    """
    shape = _SHAPE.fullmatch(data)
    if shape is None or len(data) > LONGEST:
        raise DamagedLine(f"not a line: {data[:LONGEST]!r}")
    if int(shape[4], 16) != checksum(shape[1]):
        raise DamagedLine(f"wrong checksum: {data!r}")
    kind = _KINDS.get(shape[2].decode())
    numbers = [int(text) for text in shape[3][1:].split(b",")]
    if (
        kind is None
        or len(numbers) != len(kind.ranges)
        or not all(low <= number <= high for number, (low, high) in zip(numbers, kind.ranges, strict=True))
    ):
        raise DamagedLine(f"no such line: {data!r}")
    return kind(*numbers)


@dataclass
class LineReader:
    """Finds lines in a stream of bytes.

    Attributes:
        damaged: pieces refused so far. A damaged piece never takes a good line after it along: a `$` begins anew.
    """

    damaged: int = 0
    _rest: bytes = field(default=b"", repr=False)

    def feed(self, data: bytes) -> list[Line]:
        """Take the next bytes; return the good lines that are complete now."""
        lines: list[Line] = []
        *complete, self._rest = (self._rest + data).split(b"\n")
        for piece in complete:
            before, dollar, after = piece.rpartition(b"$")
            self.damaged += bool(before)
            try:
                lines.append(decode(dollar + after + b"\n"))
            except DamagedLine:
                self.damaged += 1
        if len(self._rest) > LONGEST:
            self.damaged += 1
            _, dollar, after = self._rest[-LONGEST:].rpartition(b"$")
            self._rest = dollar + after if dollar else b""
        return lines
