"""Who may import whom, and who loads torch."""

from __future__ import annotations

import configparser
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SERVICES = sorted(path.parent.name for path in (ROOT / "services").glob("*/__main__.py"))


def test_floors_are_kept() -> None:
    outcome = subprocess.run(
        [Path(sys.executable).parent / "lint-imports", "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert outcome.returncode == 0, outcome.stdout[-4000:] + outcome.stderr[-2000:]


def test_every_module_stands_on_a_floor_and_there_are_no_exceptions() -> None:
    parser = configparser.RawConfigParser()
    parser.read(ROOT / ".importlinter")
    named = parser["importlinter:contract:floors"]["layers"].replace(":", " ").split()
    modules = {
        f"vantage.{path.stem}"
        for path in (ROOT / "vantage").iterdir()
        if (path.suffix == ".py" or (path / "__init__.py").is_file()) and path.stem != "__init__"
    }
    assert modules <= set(named)
    for section in parser.sections():
        assert not any(option.startswith(("ignore", "unmatched", "allow")) for option in parser[section]), section


@pytest.mark.parametrize("service", [name for name in SERVICES if name != "predictor"])
def test_no_service_but_the_predictor_loads_torch(service: str) -> None:
    program = f"import services.{service}.__main__, sys; sys.exit(int('torch' in sys.modules))"
    outcome = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr or f"services.{service} imports torch"


@pytest.mark.parametrize("service", SERVICES)
def test_process_files_are_thin(service: str) -> None:
    assert len((ROOT / "services" / service / "__main__.py").read_text().splitlines()) < 100
