"""Who asks for games where a log is replayed is told so, and not the log's games as if they were theirs."""

from __future__ import annotations

import pytest

from tests.stack.table import wish
from vantage.bus import InProcessNetwork
from vantage.deployment import DeploymentError
from vantage.match import Match


def test_no_games_are_played_in_a_replay() -> None:
    network = InProcessNetwork()
    network.session("replay").watch()
    match = Match(network.session("command-line"), wish(seed=1, games=1, steps=5, period=0.1))
    with pytest.raises(DeploymentError, match="being replayed"):
        take_everything(match)


def take_everything(match: Match) -> None:
    while match.turn(0.0):
        pass
