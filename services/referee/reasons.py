"""Why a game was aborted, other than for a service that failed, in the words that `Episode.reason` has."""

from schemas import REASON_LIMIT
from vantage.printable import shortened

STOPPED = "stopped on request"
OWNER_GONE = "the command that asked for these games has ended"
REPLACED = "another game was asked for"
DISCARDED = "discarded by the player"
RESTARTED = "the referee was restarted; the setup of this game has its seed and rules"
_STOPPED_FOR = "stopped: "


def stopped(why: str) -> str:
    """Return the reason of a game that was stopped, with the reason that was given for that."""
    return shortened(f"{_STOPPED_FOR}{why}", REASON_LIMIT) if why else STOPPED


def is_on_request(reason: str) -> bool:
    """Return whether a game was aborted because somebody wanted it so."""
    return reason in (STOPPED, REPLACED, DISCARDED) or reason.startswith(_STOPPED_FOR)
