"""What holds for all tests."""

import signal

from hypothesis import settings

# A machine that compiles or shares its cores is slow, not wrong.
settings.register_profile("vantage", deadline=None)
settings.load_profile("vantage")

# A shell starts what runs in its background deaf to Ctrl-C, and programs that tests start would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
