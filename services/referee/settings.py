"""How games are started, and how long the referee waits for everybody."""

from __future__ import annotations

from dataclasses import dataclass, field

from schemas import Players, Rules
from services.referee.declaration import DECLARATION


@dataclass(frozen=True)
class RefereeSettings:
    """How games are started and how long the referee waits for the players."""

    autoplay: bool = False
    """Start games without being asked, as soon as every required service is alive."""
    games: int = 0
    """How many games autoplay plays; 0 = without end."""
    seed: int = 1
    """Seed of episode 1 in autoplay; episode n uses seed + n - 1."""
    first_episode: int = 1
    """Number of the first episode."""
    rules: Rules = field(default_factory=Rules)
    """Rules of the games of autoplay."""
    players: Players = field(default_factory=Players)
    """Who plays in autoplay."""
    required: tuple[str, ...] = DECLARATION.heeds
    """Services that must be alive before a game is set up; `a|b`: one of the two."""
    settle: float = 0.5
    """Seconds to listen after the start, to hear of a game that a crashed referee left behind."""
    pause: float = 2.0
    """Seconds between games in real time."""
    setup_patience: float = 10.0
    """Seconds to wait for the first poses of a game, since the world last said how the table stands (`layout`): a real table
    says it again and again while robots drive to their starts."""
    setup_limit: float = 180.0
    """Seconds that a set-up may take in all, however often the layout is said."""
    planning_patience: float = 30.0
    """Seconds to wait for the first commands: the hider paints its value map in this time."""
    command_patience: float = 1.0
    """Seconds after which a robot without a command stays where it is (real time only)."""
    driver_patience: float = 5.0
    """Seconds without a word from the console after which nobody drives a human's hider."""
    step_patience: float = 10.0
    """Seconds to wait for the poses after a step, counted while those who embody the robots are able to answer. More than a
    driver takes by its own clock (2.5 s, 8 s where robots are rehearsed), which stands still while it does not get to run."""
    outage_patience: float = 20.0
    """Seconds for which a service that is away or silent in mid-game is waited for, where its answer is."""
    slow_patience: float = 20.0
    """Seconds to wait for poses, and for a robot's command a quarter of it, while a service reports that this machine is too
    slow: games slow down then. The first commands of a game get three times `planning_patience`."""
    owner_patience: float = 1.0
    """Seconds before the games of a disconnected owner are stopped."""
