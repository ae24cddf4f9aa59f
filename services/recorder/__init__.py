"""Writes everything that is said on the bus into MCAP logs."""
