"""Hider policies for data collection: one file each, one row in `learning.hiders.table`."""
