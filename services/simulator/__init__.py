"""The simulator: bodies and cameras of both robots."""
