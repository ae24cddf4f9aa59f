"""The human as the hider: keys become one primitive a step, and a step's messages its answer, as any hider gives it."""

from __future__ import annotations

from typing import Any

from schemas import ColorImage, Command, DepthImage, Episode, Message, Pose, Primitive, StateImage, Tick
from vantage.perception.state_image import perceive
from vantage.service import Publish, Send, StepJoin, Unexpected
from vantage.world.camera import Camera

HUMAN = "human"
"""`players.hider` of a game that a human drives."""
JOINED = ("hider/pose", "hider/depth", "hider/color", "tick")
"""What a step consists of, in the order of `answer`."""
HEARD = frozenset(JOINED)


class Keys:
    """What is held counts at each step; of keys that came and went between two steps the last one counts once, before that."""

    def __init__(self) -> None:
        self._held: dict[Primitive, bool] = {}  # in order of pressing -> whether a step has used it
        self._tapped: Primitive | None = None

    def press(self, primitive: Primitive) -> None:
        if primitive not in self._held:
            self._held[primitive] = False

    def release(self, primitive: Primitive) -> None:
        if self._held.pop(primitive, True) is False:
            self._tapped = primitive

    def let_go(self) -> None:
        """Nobody holds anything."""
        self._held.clear()
        self._tapped = None

    def forget_taps(self) -> None:
        """What was tapped while the clock stood still is not to move the robot later."""
        self._tapped = None

    def take(self) -> Primitive:
        """Return what the robot does in this step."""
        if self._tapped is not None:
            primitive, self._tapped = self._tapped, None
            return primitive
        if not self._held:
            return "stay"
        primitive = next(reversed(self._held))
        self._held[primitive] = True
        return primitive


Complete = tuple[Message, ...]


def warm_up() -> None:
    """See one blank view: loads the kernels (the first time compiles them) before a human waits for them."""
    camera = Camera()
    picture: dict[str, Any] = {"stamp": 0, "width": camera.width, "height": 1, "intrinsics": camera.intrinsics()}
    depth, color = DepthImage(data=bytes(2 * camera.width), **picture), ColorImage(data=bytes(3 * camera.width), **picture)
    perceive(depth, color, Pose(stamp=0, x=0.6, y=0.6, heading=0.0), "hider")


class HumanHider:
    """Joins the hider's messages of a game that a human drives. In other games it keeps nothing."""

    def __init__(self) -> None:
        self._join = StepJoin(JOINED)
        self.episode: Episode | None = None
        """The game that the human drives, while it is set up or running."""

    def see(self, episode: Episode) -> Complete | None:
        """Take in what the referee says; return a step that is complete already."""
        playing = episode.phase in ("setup", "running") and episode.players.hider == HUMAN
        again = episode.phase == "setup" and (self.episode is None or self.episode.seed != episode.seed)
        if episode.episode == self._join.episode and not again:
            self.episode = episode if playing else None
            return None
        complete = self._join.begin(episode.episode)
        self.episode = episode if playing else None
        return complete if playing else None

    def add(self, key: str, message: Message) -> Complete | None:
        """Take in a message of `HEARD`; return its step once it is complete.

        What comes twice or late is shown all the same, so it is no trouble here.
        """
        if isinstance(message, Tick) and message.late:
            return None
        if self.episode is None and message.episode <= self._join.episode:
            return None
        try:
            return self._join.add(key, message)
        except Unexpected:
            return None

    def forget(self) -> None:
        """Begin anew."""
        self._join = StepJoin(JOINED)
        self.episode = None


def answer(complete: Complete, primitive: Primitive) -> list[Send]:
    """Return what the human's hider says to a complete step."""
    pose, depth, color, _tick = complete
    assert isinstance(pose, Pose) and isinstance(depth, DepthImage) and isinstance(color, ColorImage)
    view = perceive(depth, color, pose, "hider")
    other_x, other_y = view.other or (None, None)
    stamp, episode, step = depth.stamp, pose.episode, pose.step
    image = StateImage(stamp=stamp, episode=episode, step=step, data=view.image.tobytes(), other_x=other_x, other_y=other_y)
    return [
        Publish("hider/view", image),
        Publish("hider/command", Command(stamp=stamp, episode=episode, step=step, primitive=primitive)),
    ]
