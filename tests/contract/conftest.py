"""Both tables, of which every test of the contract gets each in turn. What is slow to make, a calibration, is made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.contract.tables import Calibration, RehearsedTable, SimulatedTable, TableOnTest, calibrate


@pytest.fixture(scope="session")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    folder: Path = tmp_path_factory.mktemp("calibration")
    return calibrate(folder)


@pytest.fixture
def rehearsed(calibration: Calibration) -> RehearsedTable:
    return RehearsedTable(calibration)


@pytest.fixture(params=["simulated", "rehearsed"])
def table(request: pytest.FixtureRequest) -> TableOnTest:
    if request.param == "simulated":
        return SimulatedTable()
    rehearsed: RehearsedTable = request.getfixturevalue("rehearsed")
    return rehearsed
