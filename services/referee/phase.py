"""What the referee waits for."""

from __future__ import annotations

from enum import Enum


class Phase(Enum):
    """The state of the referee; the value says in words what it is doing."""

    LISTENING = "listening for a game left behind"
    IDLE = "waiting for a game to be asked for, or for a service"
    SETUP = "waiting for the first poses"
    COMMANDS = "waiting for commands"
    POSES = "waiting for the step to be executed"
    PACING = "waiting for the next tick"
    PAUSE = "between games"
