"""The seeker as a pure core: looks, remembers, and answers every step with a primitive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from schemas import PRIMITIVES, ColorImage, Command, DepthImage, Episode, Pose, StateImage, Tick
from services.seeker.declaration import DECLARATION
from services.seeker.policy import PRESETS, Attention, SeekerMemory, forget_primitive, reset, seeker_step
from vantage.perception.state_image import perceive
from vantage.service import Arrived, Publish, Received, Send, StepJoin, Unexpected


@dataclass(frozen=True)
class SeekerSettings:
    """How the seeker runs. Which preset plays is said by each episode (`players.seeker`)."""

    publish_view: bool = True
    """Draw and publish `seeker/view`. Data collection, which draws from the logs, may do without."""


class SeekerCore:
    """See module. Begins anew with every episode, also in the middle of one, then with an empty memory."""

    declaration = DECLARATION

    def __init__(self, settings: SeekerSettings | None = None) -> None:
        self._settings = settings or SeekerSettings()
        self._join = StepJoin(("seeker/pose", "seeker/depth", "seeker/color", "tick"))
        self._memory = SeekerMemory.empty()
        self._attention: Attention | None = None
        self._seed = 0
        self._answered = -1

    def wake_at(self) -> int | None:
        return None

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if not isinstance(received, Arrived):
            return ()
        message = received.message
        if isinstance(message, Episode):
            complete = self._on_episode(message)
        elif isinstance(message, Tick) and message.late:
            if "seeker" in message.late and (message.episode, message.step) == (self._join.episode, self._answered):
                forget_primitive(self._memory)
            return ()
        else:
            complete = self._join.add(received.key, message)
        return self._on_step(*complete) if complete and self._attention is not None else ()  # type: ignore[arg-type]

    def _on_episode(self, episode: Episode) -> tuple[object, ...] | None:
        if episode.phase in ("ended", "aborted"):
            if episode.episode == self._join.episode:
                self._attention = None
            return None
        if episode.episode < self._join.episode and episode.phase != "setup":  # a replayed log goes back to an earlier game
            raise Unexpected(f"episode {episode.episode} came after episode {self._join.episode} had begun")
        if episode.phase == "running" and episode.episode == self._join.episode:
            return None
        self._attention = PRESETS.get(episode.players.seeker)
        self._seed = episode.seed
        self._answered = -1
        reset(self._memory)
        complete = self._join.begin(episode.episode)
        if self._attention is None:
            raise Unexpected(
                f"episode {episode.episode} wants the seeker `{episode.players.seeker}`; "
                f"there are: {', '.join(PRESETS)}. The seeker stays until the next episode"
            )
        return complete

    def _on_step(self, pose: Pose, depth: DepthImage, color: ColorImage, _tick: Tick) -> Sequence[Send]:
        assert self._attention is not None
        view = perceive(depth, color, pose, "seeker", draw=self._settings.publish_view)
        other_x, other_y = view.other or (0.0, 0.0)
        primitive = seeker_step(
            self._memory,
            self._attention.look_interval,
            self._attention.needs_whole,
            self._attention.cuts_corners,
            self._seed,
            pose.step,
            view.ranges,
            view.kinds,
            depth.intrinsics.fx,
            depth.intrinsics.cx,
            pose.x,
            pose.y,
            pose.heading,
            view.seen_columns if view.other else 0,
            view.whole,
            other_x,
            other_y,
        )
        self._answered = pose.step
        command = Command(stamp=depth.stamp, episode=pose.episode, step=pose.step, primitive=PRIMITIVES[primitive])
        sends: list[Send] = [Publish("seeker/command", command)]
        if self._settings.publish_view:
            image = StateImage(
                stamp=depth.stamp,
                episode=pose.episode,
                step=pose.step,
                data=view.image.tobytes(),
                other_x=view.other[0] if view.other else None,
                other_y=view.other[1] if view.other else None,
            )
            sends.append(Publish("seeker/view", image))
        return sends
