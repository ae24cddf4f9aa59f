"""A process that writes poses until it is killed; prints each sequence number after its message was handed to the log.

Run: python -m tests.log.crash_writer PATH RATE
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from schemas import Pose, encode
from vantage.log import LogWriter, RunMetadata


def main(path: Path, rate: float) -> None:
    log = LogWriter(path, RunMetadata())
    number = 0
    start = time.monotonic()
    while True:
        now = time.time_ns()
        log.write(
            "hider/pose",
            encode(Pose(stamp=now, x=0.1, y=0.2, heading=0.3)),
            log_time=now,
            publish_time=now,
            sequence=number,
            publisher="simulator",
        )
        print(now, number, flush=True)
        number += 1
        time.sleep(max(0.0, start + number / rate - time.monotonic()))


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
