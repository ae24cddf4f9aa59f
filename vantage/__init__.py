"""Vantage: see the world from the opponent's vantage point."""
