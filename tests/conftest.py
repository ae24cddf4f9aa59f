"""What holds for all tests."""

from hypothesis import settings

# A machine that compiles or shares its cores is slow, not wrong.
settings.register_profile("vantage", deadline=None)
settings.load_profile("vantage")
