"""A few kills and stops at random moments, supervisord included; `python -m tests.stack.kills` is the whole campaign."""

from __future__ import annotations

from tests.stack.kills import SUPERVISOR, Campaign, Settings
from tests.stack.table import PATIENCE, Table

SEED = 6


def test_everything_comes_again_and_nothing_is_lost_unseen() -> None:
    with Table() as table:
        assert table.started.returncode == 0, table.started.stderr
        campaign = Campaign(Settings(kills=4, seed=SEED, within=PATIENCE, stopped=3.0), table)
        campaign.run()
    assert not campaign.violations, str(campaign)
    assert sum(len(fault.victims) for fault in campaign.faults) > 4, "some two at once"
    assert any(SUPERVISOR in fault.victims for fault in campaign.faults)
    assert campaign.outcomes["ended"] and campaign.logs.messages
