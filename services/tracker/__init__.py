"""The tracker: real cameras to layout, tracks, and the poses and pictures of each step."""
