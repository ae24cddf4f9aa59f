"""MCAP logs: write, read, recover, split, episodes; the translation to viewer schemas."""

from vantage.log.metadata import RunMetadata, source_commit
from vantage.log.reader import BrokenLog, Log, Record, find_logs, open_log, read
from vantage.log.writer import LogWriter

__all__ = ["BrokenLog", "Log", "LogWriter", "Record", "RunMetadata", "find_logs", "open_log", "read", "source_commit"]
