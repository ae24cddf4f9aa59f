"""What holds for all tests."""

import signal

import pytest
from hypothesis import settings
from xdist.scheduler import LoadFileScheduling  # type: ignore[import-untyped]

CONSOLE = "tests/console/"

# A machine that compiles or shares its cores is slow, not wrong.
settings.register_profile("vantage", deadline=None)
settings.load_profile("vantage")

# A shell starts what runs in its background deaf to Ctrl-C, nohup deaf to a closed terminal, and programs that tests start would
# inherit that.
for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)


class ByFile(LoadFileScheduling):
    """Tests of one file run in one process, and so do all of the console's page: they share a deployment and a browser."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        return CONSOLE if file.startswith(CONSOLE) else file


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> ByFile:
    return ByFile(config, log)
