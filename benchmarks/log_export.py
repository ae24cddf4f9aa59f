"""How fast a log is exported, and with how much memory: `python benchmarks/log_export.py [GAMES]`.

Real games with 160 x 120 pictures; each format in a process of its own, so that its memory is its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent.parent
VANTAGE = Path(sys.executable).parent / "vantage"


def main() -> None:
    games = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    # Made in another process: a child counts its parent's memory as its own peak.
    home = tempfile.TemporaryDirectory(prefix="vantage-export-")
    log = Path(home.name) / "real.mcap"
    make = f"from pathlib import Path; from tests.log.exporting import make_log; make_log(Path({home.name!r}), {games}, 100)"
    subprocess.run([sys.executable, "-c", make], check=True, cwd=HERE)
    size = log.stat().st_size / 1e6
    print(f"{games} games of 100 steps, log {size:.0f} MB, {games * 100 * 192 / 1000:.0f} MB of pictures")
    for format in ("foxglove", "rerun", "lerobot", "video"):
        with tempfile.TemporaryDirectory() as folder:
            started = time.monotonic()
            process = subprocess.Popen(
                [VANTAGE, "log", "export", log, "--as", format, "--to", Path(folder) / "out", "--without-catching"],
                stdout=subprocess.DEVNULL,
            )
            _, status, used = os.wait4(process.pid, 0)
            took = time.monotonic() - started
            files = [path for path in Path(folder).rglob("*") if path.is_file()]
            written = sum(path.stat().st_size for path in files) / 1e6
            print(
                f"{format:9} exit {os.waitstatus_to_exitcode(status)}  {took:6.1f} s  {games * 100 / took:7.0f} steps/s  "
                f"peak {used.ru_maxrss / 1024:5.0f} MB  {len(files)} files, {written:.0f} MB",
                flush=True,
            )


if __name__ == "__main__":
    main()
