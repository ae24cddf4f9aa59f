"""Installs other people's readers into a folder of /tmp and lets each check our exports: `python -m tests.log.readers [LOG]`.

Needs: node and npm, ffprobe (`apt-get install nodejs npm ffmpeg`), a package index for pip. Exit code 1 when a check failed.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path

from tests.log.exporting import real_log
from tests.log.readers import programs


def main() -> int:
    log = Path(sys.argv[1]) if len(sys.argv) > 1 else real_log()
    print(f"log: {log}, {log.stat().st_size / 1e6:.1f} MB")
    steps = (
        ("node with @mcap/core", programs.has_node, programs.install_node, programs.check_node),
        ("rerun mcap check", None, None, programs.check_rerun_mcap),
        ("rerun rrd verify", None, None, programs.check_rerun_recording),
        ("LeRobot's loader", programs.has_lerobot, programs.install_lerobot, programs.check_lerobot),
        ("ffprobe", None, None, programs.check_ffprobe),
    )
    failed = 0
    for name, is_there, install, check in steps:
        work = Path(tempfile.mkdtemp(prefix="vantage-readers-"))
        started = time.monotonic()
        try:
            if is_there is not None and install is not None and not is_there():
                print(f"{name}: installing ...", flush=True)
                install()
                started = time.monotonic()
            print(f"{name}: {check(log, work)} ({time.monotonic() - started:.1f} s)", flush=True)
        except (RuntimeError, AssertionError, OSError) as error:
            failed += 1
            print(f"{name}: FAILED: {error}", flush=True)
        finally:
            shutil.rmtree(work, ignore_errors=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
