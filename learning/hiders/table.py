"""The hider table: every policy of `vantage collect --hider`, by name. A new policy is one file and one row here."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from learning.hiders.evader import SKILLS, Evader
from learning.hiders.goal_walk import GoalWalk
from learning.hiders.policy import HiderPolicy
from learning.hiders.random_primitives import RandomPrimitives
from learning.hiders.replay import Replay, Trajectories

Make = Callable[[int, np.random.Generator, Trajectories], HiderPolicy]


def policy_generator(seed: int) -> np.random.Generator:
    """Return the generator of a hider's own choices in the episode of this seed."""
    return np.random.default_rng([seed, 0x41DE])


HIDERS: dict[str, Make] = {
    "random": lambda steps, generator, _: RandomPrimitives(steps, generator),
    "goal-walk": lambda steps, generator, _: GoalWalk(steps, generator),
    "scripted": lambda steps, generator, _: Evader(steps, generator, int(generator.choice(SKILLS))),
    "scripted-1": lambda steps, generator, _: Evader(steps, generator, 1),
    "scripted-2": lambda steps, generator, _: Evader(steps, generator, 2),
    "scripted-3": lambda steps, generator, _: Evader(steps, generator, 3),
    "replay": Replay,
}
"""(maximum steps, generator of the episode, recorded trajectories) -> policy."""
