"""Exports checked by other people's readers: `python -m tests.log.readers`."""
