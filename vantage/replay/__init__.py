"""Playing a recorded log on the bus, with the log's clock, so that services work on it as if it were live."""
