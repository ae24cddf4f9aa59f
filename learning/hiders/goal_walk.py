"""Goal walks: drive to a random goal as the planner would, without regard to the seeker."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.planner.controller import Controller
from vantage.perception.state_image import Perceived
from vantage.world.arena import GOALS


def chosen_goal(
    controller: Controller, generator: np.random.Generator, x: float, y: float, heading: int
) -> tuple[float, float] | None:
    """Return the goal (m) that a goal walk draws among those that look reachable; None where there is none."""
    reachable = np.flatnonzero(controller.reachable_goals(x, y, heading))
    if len(reachable) == 0:
        return None
    goal = GOALS[generator.choice(reachable)]
    return float(goal[0]), float(goal[1])


class GoalWalk:
    """Draws one of the goals that look reachable at the start and drives there with the planner's low-level controller."""

    def __init__(self, maximum_steps: int, generator: np.random.Generator) -> None:
        self._maximum_steps = maximum_steps
        self._generator = generator
        self._controller = Controller()
        self._has_goal = False

    def act(self, view: Perceived, x: float, y: float, heading: int, step: int) -> int:
        self._controller.observe(view, x, y, heading, step)
        if not self._has_goal:
            self._has_goal = True
            goal = chosen_goal(self._controller, self._generator, x, y, heading)
            if goal is not None:
                self._controller.go_to(*goal, x, y, heading)
        return self._controller.drive(x, y, heading)

    def new_path(self, x: float, y: float, heading: int, step: int) -> NDArray[np.float64] | None:
        if not self._controller.path_changed:
            return None
        return self._controller.planned_path(x, y, heading, self._maximum_steps - step)
