"""The scripted evader: reacts to the seeker it sees, at several levels of skill. It stands in for human play.

Its trajectories are recorded with catches ignored and played back open loop from other starts (paper, Data Collection).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from services.planner.controller import Controller
from vantage.perception.state_image import Perceived
from vantage.world.arena import GOALS, LEFT, RIGHT

SKILLS = (1, 2, 3)
_RETHINK_STEPS = {1: 40, 2: 20, 3: 10}
_TEMPERATURE = {1: 0.30, 2: 0.10, 3: 0.02}  # m of advantage that noise may hide
_LOOK_AROUND = 0.02


class Evader:
    """Runs to the goal that it can reach well before the seeker; thinks anew the more often, the more skilled it is."""

    def __init__(self, maximum_steps: int, generator: np.random.Generator, skill: int) -> None:
        self._generator = generator
        self._rethink = _RETHINK_STEPS[skill]
        self._temperature = _TEMPERATURE[skill]
        self._controller = Controller()
        self._seeker: tuple[float, float] | None = None
        self._next_thought = 0

    def act(self, view: Perceived, x: float, y: float, heading: int, step: int) -> int:
        self._controller.observe(view, x, y, heading, step)
        if view.other is not None:
            self._seeker = view.other
        if step >= self._next_thought or self._controller.arrived:
            self._next_thought = step + self._rethink
            self._choose_goal(x, y, heading)
        if self._controller.arrived and self._generator.random() < _LOOK_AROUND:
            return int(self._generator.choice((LEFT, RIGHT)))
        return self._controller.drive(x, y, heading)

    def new_path(self, x: float, y: float, heading: int, step: int) -> NDArray[np.float64] | None:
        return None

    def _choose_goal(self, x: float, y: float, heading: int) -> None:
        reachable = np.flatnonzero(self._controller.reachable_goals(x, y, heading))
        if len(reachable) == 0:
            return
        goals = GOALS[reachable]  # [n, 2]
        advantage = -0.5 * np.hypot(goals[:, 0] - x, goals[:, 1] - y)
        if self._seeker is not None:
            seeker_x, seeker_y = self._seeker
            advantage += np.hypot(goals[:, 0] - seeker_x, goals[:, 1] - seeker_y)
            towards = math.atan2(seeker_y - y, seeker_x - x)
            bearing = np.arctan2(goals[:, 1] - y, goals[:, 0] - x)
            advantage -= 0.2 * np.cos(bearing - towards)
        advantage += self._temperature * self._generator.gumbel(size=len(advantage))
        goal = goals[int(np.argmax(advantage))]
        self._controller.go_to(float(goal[0]), float(goal[1]), x, y, heading)
