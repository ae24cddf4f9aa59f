"""A hider policy as a service core: joins the step's messages, asks the policy, publishes its command and its plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from learning.hiders.policy import HiderPolicy
from schemas import PRIMITIVES, ColorImage, Command, DepthImage, Episode, Plan, Pose, StateImage
from vantage.perception.state_image import perceive
from vantage.service import Arrived, Declaration, Publish, Received, Send, StepJoin
from vantage.world.motion import heading_number

DECLARATION = Declaration(
    name="hider",
    inputs=("episode", "tick", "hider/pose", "hider/depth", "hider/color"),
    outputs=("hider/command", "hider/view", "hider/plan", "health/hider"),
)

MakePolicy = Callable[[Episode], HiderPolicy]


class HiderCore:
    """Drives the hider with the policy that `make_policy` gives for each episode.

    Args:
        publish_view: whether to draw and publish the hider's state image (training sets draw it again from the pictures).
    """

    declaration = DECLARATION

    def __init__(self, make_policy: MakePolicy, publish_view: bool = True) -> None:
        self._make_policy = make_policy
        self._publish_view = publish_view
        self._join = StepJoin(("hider/pose", "hider/depth", "hider/color", "tick"))
        self._policy: HiderPolicy | None = None
        self._horizon = 0

    def wake_at(self) -> int | None:
        return None

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if not isinstance(received, Arrived):
            return ()
        message = received.message
        if isinstance(message, Episode):
            if message.phase != "setup":
                return ()
            self._policy = self._make_policy(message)
            self._horizon = message.rules.maximum_steps
            complete = self._join.begin(message.episode)
        else:
            complete = self._join.add(received.key, message)
        return self._act(*complete) if complete else ()  # type: ignore[arg-type]

    def _act(self, pose: Pose, depth: DepthImage, color: ColorImage, _tick: object) -> Sequence[Send]:
        assert self._policy is not None
        view = perceive(depth, color, pose, "hider", draw=self._publish_view)
        heading = int(heading_number(pose.heading))
        primitive = self._policy.act(view, pose.x, pose.y, heading, pose.step)
        path = self._policy.new_path(pose.x, pose.y, heading, pose.step)
        stamp, episode, step = depth.stamp, pose.episode, pose.step
        sends: list[Send] = []
        if self._publish_view:
            other_x, other_y = view.other or (None, None)
            image = StateImage(
                stamp=stamp, episode=episode, step=step, data=view.image.tobytes(), other_x=other_x, other_y=other_y
            )
            sends.append(Publish("hider/view", image))
        if path is not None:
            plan = Plan(stamp=stamp, episode=episode, step=step, horizon=self._horizon, path=path.astype(np.float32).tobytes())
            sends.append(Publish("hider/plan", plan))
        command = Command(stamp=stamp, episode=episode, step=step, primitive=PRIMITIVES[primitive])
        sends.append(Publish("hider/command", command))
        return sends
