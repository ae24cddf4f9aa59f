"""Setting up a real table: what is printed, calibrated and checked before the first game. Behind `vantage table`."""
