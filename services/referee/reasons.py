"""Why a game was aborted, other than for a service that failed, in the words that `Episode.reason` has."""

STOPPED = "stopped on request"
REPLACED = "another game was asked for"
DISCARDED = "discarded by the player"
ON_REQUEST = frozenset({STOPPED, REPLACED, DISCARDED})
"""Somebody wanted it so."""
RESTARTED = "the referee was restarted; the setup of this game has its seed and rules"
