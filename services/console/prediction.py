"""What the seeker would see on the way to a goal: asked of the predictor, as the planner asked when it looked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from schemas import Message, Plan, PredictReply, PredictRequest
from services.console.frames import addressed, frame
from vantage.service import Ask, Send, Write

HORIZONS = 8
"""Predicted views of one path."""
TIMEOUT = 10.0
"""Seconds in which the predictor has to answer."""
UNDER_WAY = 4
"""Questions to the predictor at a time: it also plans for the hider."""


@dataclass(slots=True)
class _Question:
    client: int
    goal: int
    request: PredictRequest


def chosen_horizons(horizons: tuple[int, ...]) -> tuple[int, ...]:
    """Return about eight of the planner's horizons, evenly spread, the last among them."""
    if len(horizons) <= HORIZONS:
        return horizons
    places = np.linspace(len(horizons) / HORIZONS - 1, len(horizons) - 1, HORIZONS).round().astype(int)
    return tuple(horizons[place] for place in places)


class Predictions:
    """The present plan and the planner's question behind it; asks again with one of its paths.

    Of each page the newest goal counts: one that is clicked while an answer is awaited is asked for after it.

    Args:
        device: name of the pages' device.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._plan: Plan | None = None
        self._request: PredictRequest | None = None
        self._tokens = 0
        self._asked: dict[int, _Question] = {}
        self._wanted: dict[int, int] = {}  # client -> goal, in order of asking

    @property
    def unpredictable(self) -> str:
        """Why no goal of the present plan can be asked for, for people; empty when one can."""
        if self._plan is None:
            return "there is no plan yet"
        if not self._plan.values:
            return "this hider judges no goals: there is nothing to predict along"
        if self._request is None or not _belong(self._plan, self._request):
            # The planner asks once a game, and the bus keeps no question for who comes later. Only that question has the
            # state image and the paths of the step in which it looked.
            return "the console was started after this game was planned: goals can be clicked from the next game on"
        return ""

    def see_plan(self, plan: Plan) -> None:
        self._plan = plan

    def see_request(self, request: PredictRequest) -> bool:
        """Take in a question that somebody asked; return whether that changes what can be asked of the present plan."""
        if request.views:
            return False  # a console's: the planner asks for no views
        before = self.unpredictable
        self._request = request
        return self.unpredictable != before

    def begin(self, episode: int) -> None:
        """Another game is set up: the last one's plan can be asked about no more."""
        if self._plan is not None and self._plan.episode != episode:
            self.forget()

    def forget(self) -> None:
        """Begin anew: nothing that was asked is of interest any more."""
        self._plan = self._request = None
        self._asked.clear()
        self._wanted.clear()

    def forget_client(self, client: int) -> None:
        self._wanted.pop(client, None)

    def want(self, client: int, goal: int) -> list[Send]:
        """A page asks for a goal."""
        self._wanted[client] = goal
        return self._go_on()

    def answered(self, token: int, reply: Message | None, error: str) -> list[Send]:
        """The predictor answered, or did not."""
        question = self._asked.pop(token, None)
        if question is None:
            return []
        if isinstance(reply, PredictReply):
            data = self._frame_of(question, reply)
        else:
            data = _refusal(question.goal, error or "the predictor did not answer", question.request)
        return [Write(self._device, addressed(question.client, data)), *self._go_on()]

    def _go_on(self) -> list[Send]:
        sends: list[Send] = []
        busy = {question.client for question in self._asked.values()}
        for client, goal in list(self._wanted.items()):
            if client in busy or len(self._asked) >= UNDER_WAY:
                continue
            del self._wanted[client]
            request, reason = self._request_for(goal)
            if request is None:
                sends.append(Write(self._device, addressed(client, _refusal(goal, reason, self._plan))))
                continue
            self._tokens += 1
            self._asked[self._tokens] = _Question(client, goal, request)
            sends.append(Ask("predictor", request, TIMEOUT, self._tokens))
        return sends

    def _request_for(self, goal: int) -> tuple[PredictRequest | None, str]:
        if self.unpredictable:
            return None, self.unpredictable
        assert self._plan is not None and self._request is not None
        if self._plan.values[goal] is None:
            return None, "the goal is blocked: no path leads there"
        paths = _paths(self._request)
        row = sum(value is not None for value in self._plan.values[:goal])
        horizons = chosen_horizons(self._request.horizons)
        return replace(
            self._request,
            path_count=1,
            paths=paths[row].tobytes(),
            horizons=horizons,
            views=tuple((0, number) for number in range(len(horizons))),
        ), ""

    def _frame_of(self, question: _Question, reply: PredictReply) -> bytes:
        request = question.request
        caught = np.frombuffer(reply.caught, "<f4")
        if len(caught) != len(request.horizons) or len(reply.views) != len(request.views):
            said = f"the predictor answered {len(caught)} probabilities and {len(reply.views)} views"
            return _refusal(question.goal, f"{said}, asked were {len(request.horizons)}", request)
        fields = {
            **_place(request),
            "goal": question.goal,
            "steps": [request.step + horizon for horizon in request.horizons],
            "caught": [float(value) for value in caught],
            "path": _paths(request)[0].round(4).tolist(),
            "error": "",
            "elapsed": reply.elapsed,
        }
        return frame("prediction", fields, b"".join(reply.views))


def _refusal(goal: int, error: str, about: Message | None) -> bytes:
    place = {} if about is None else _place(about)
    return frame("prediction", {**place, "goal": goal, "steps": [], "caught": [], "path": [], "error": error, "elapsed": 0.0})


def _place(message: Message) -> dict[str, Any]:
    return {"episode": message.episode, "step": message.step, "stamp": str(message.stamp)}


def _belong(plan: Plan, request: PredictRequest) -> bool:
    """Whether a plan was made from the answer to a question: its open goals are the question's paths, in order."""
    goals = sum(value is not None for value in plan.values)
    return (plan.episode, plan.horizon, goals) == (request.episode, request.path_steps, request.path_count)


def _paths(request: PredictRequest) -> NDArray[np.float32]:
    """Positions, m: [paths, steps, 2]."""
    return np.frombuffer(request.paths, "<f4").reshape(request.path_count, request.path_steps, 2)
