"""The bus under test."""

from collections.abc import Iterator

import pytest
from bus_network import InProcess, Network, Zenoh


@pytest.fixture(params=["in_process", "zenoh"])
def network(request: pytest.FixtureRequest) -> Iterator[Network]:
    network: Network = InProcess() if request.param == "in_process" else Zenoh()
    yield network
    network.close()


@pytest.fixture
def zenoh_network() -> Iterator[Zenoh]:
    network = Zenoh()
    yield network
    network.close()
