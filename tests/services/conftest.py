"""A table with a page of the console open, on which the planner plays unless a file says otherwise; and the web server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from services.planner.core import PlannerCore
from services.predictor.core import PredictorCore
from tests.services.console_game import Table
from tests.services.console_server import Console
from vantage.service import Core


@pytest.fixture(scope="session")
def small_networks() -> Any:
    """Untrained networks: they answer as trained ones do, and faster."""
    import torch

    from vantage.networks.inference import Inference
    from vantage.networks.vpn import Vpn, VpnSettings
    from vantage.networks.vpt_tob import VptTob, VptTobSettings

    torch.manual_seed(0)
    return Inference(VptTob(VptTobSettings(width=0.25)), Vpn(VpnSettings(width=4)), batch=32, threads=1)


@pytest.fixture
def others(small_networks: Any) -> dict[str, Core]:
    """Who plays besides referee, simulator, seeker and console."""
    return {"planner": PlannerCore(), "predictor": PredictorCore(small_networks)}


@pytest.fixture
def table(others: dict[str, Core]) -> Table:
    table = Table(others)
    table.come()
    table.run_for(1.0)
    return table


@pytest.fixture
def console(tmp_path: Path) -> Iterator[Console]:
    opened = Console(tmp_path)
    yield opened
    opened.close()


@pytest.fixture
def elsewhere(tmp_path: Path) -> Iterator[Console]:
    opened = Console(tmp_path, host="127.0.0.2")
    yield opened
    opened.close()
