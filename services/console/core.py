"""The console as a pure core: what the bus says goes to the pages, what pages ask for goes, within bounds, to the bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from schemas import Control, Episode, Gap, Health, Message, Plan, Playback, Pose, PredictRequest, StateImage
from services.console import requests, wishes
from services.console.declaration import DECLARATION
from services.console.driven import Driven
from services.console.events import PAGE, PageEvent, Refusals
from services.console.frames import ALL, addressed, frame, frame_of, notice
from services.console.human import HEARD, HUMAN, Complete, HumanHider, answer
from services.console.past import PastViews
from services.console.prediction import Predictions
from services.console.rate import Rate
from services.console.refused import RefusedLately
from services.console.reports import Reports
from services.console.score import Score
from services.console.session import NOBODY, Session
from vantage.service import SECOND, Answered, Arrived, Captured, Publish, Received, Send, Woken, Write

CONTROLS_A_SECOND, CONTROLS_BURST = 8.0, 16.0
"""Messages to `control` for all pages together."""
GRACE = SECOND
"""ns in which a game of a human that nobody at our pages drives may turn out to be a replay, or somebody take the wheel."""


class ConsoleCore:
    """See module. Keeps the last message of each key, so that nothing is encoded while no page is there.

    Args:
        about: fields of the frame `welcome`.
    """

    declaration = DECLARATION

    def __init__(self, about: Mapping[str, Any]) -> None:
        self._about = dict(about)
        self._clients: set[int] = set()
        self._controls = Rate(CONTROLS_A_SECOND, CONTROLS_BURST)
        self._refused = RefusedLately()
        self._reports = Reports()
        self._next_second = 0
        self._without_server = ""
        self._predictions = Predictions(PAGE)
        self._forget()

    def _forget(self) -> None:
        """Begin anew: all that was learned of games."""
        self._latest: dict[str, Message] = {}
        self._playback: Playback | None = None
        self._episode: Episode | None = None
        self._human = HumanHider()
        self._unanswered: Complete | None = None
        self._grace_until: int | None = None
        self._pause_asked = False
        self._past = PastViews()
        self._driven_paths = Driven()
        self._predictions.forget()
        self._score = Score()
        self._session = Session()
        self._stale: set[str] = {"score", "session", "recording"}

    @property
    def trouble(self) -> str:
        """Why no page can be shown, and who was refused lately; empty when all is well."""
        return "; ".join(text for text in (self._without_server, self._refused.trouble) if text)

    def wake_at(self) -> int | None:
        if self._grace_until is None or self._human.episode is None or self._driven:
            return self._next_second
        return min(self._next_second, self._grace_until)

    def step(self, received: Received, now: int) -> Sequence[Send]:
        sends: list[Send] = []
        if isinstance(received, Arrived):
            sends += self._on_message(received.key, received.message, now)
        elif isinstance(received, Captured):
            sends += self._on_captured(received, now)
        elif isinstance(received, Answered):
            sends += self._predictions.answered(received.token, received.reply, received.error)
        elif isinstance(received, Woken):
            sends += self._on_time(now)
        sends += self._mind_the_wheel(now)
        if self._stale and self._clients:
            sends += [_to(ALL, self._own[key](now)) for key in sorted(self._stale)]
            self._stale.clear()
        return sends

    @property
    def _own(self) -> dict[str, Callable[[int], bytes]]:
        """Frames of what the console itself knows."""
        return {
            "services": self._reports.frame,
            "recording": self._reports.recording,
            "score": lambda _: self._score.frame(),
            "session": lambda _: self._session.frame(),
        }

    # What the bus says

    def _on_message(self, key: str, message: Message, now: int) -> list[Send]:
        if isinstance(message, Health):
            self._reports.add(message, now)
            return []
        if isinstance(message, Gap):
            self._reports.miss(message)
            self._stale.add("recording")
            return []
        if isinstance(message, Control):
            return self._on_control(message)
        if isinstance(message, PredictRequest):
            changed = self._predictions.see_request(message)
            return self._show("hider/plan") if changed else []
        sends: list[Send] = []
        if isinstance(message, Playback):
            return self._on_playback(message)
        self._latest[key] = message
        if isinstance(message, Episode):
            sends += self._on_episode(message, now)
        elif isinstance(message, Plan):
            self._predictions.see_plan(message)
        elif isinstance(message, Pose):
            self._driven_paths.add(key.partition("/")[0], message)
        elif isinstance(message, StateImage) and key == "seeker/view":
            self._past.add(message)
        sends += self._show(key)
        if key in HEARD and self._playback is None:
            sends += self._on_step(self._human.add(key, message), now)
        return sends

    def _show(self, key: str) -> list[Send]:
        return [_to(ALL, self._frame_of(key))] if self._clients and key in self._latest else []

    def _frame_of(self, key: str) -> bytes:
        message = self._latest[key]
        if isinstance(message, Plan):
            return frame_of(key, message, predictable=self._predictions.predictable)
        return frame_of(key, message)

    def _on_episode(self, episode: Episode, now: int) -> list[Send]:
        before, self._episode = self._episode, episode
        if before is None or before.episode != episode.episode or before.seed != episode.seed:
            self._latest = {
                key: message
                for key, message in self._latest.items()
                if message.episode == episode.episode or key in ("playback", "hider/track", "seeker/track")
            }
            self._predictions.begin(episode.episode)
            self._pause_asked = False
            # Without a driver of ours it may be a game in a log; a page that drove the last game goes on at once.
            self._grace_until = now + GRACE
        if episode.phase == "setup":
            self._score.begin(episode.episode)
        if episode.paused:
            self._pause_asked = False
        self._score.add(episode)
        self._session.see(episode, self._score.is_discarded(episode.episode))
        self._stale |= {"score", "session"}
        return self._on_step(self._human.see(episode), now) if self._playback is None else []

    def _on_control(self, control: Control) -> list[Send]:
        if control.action == "discard" and (self._score.knows(control.episode) or self._is_on(control.episode)):
            self._score.discard(control.episode)
        self._session.hear(control)
        self._stale |= {"score", "session"}
        return []

    def _on_playback(self, playback: Playback) -> list[Send]:
        jumped = self._playback is not None and playback.jumps != self._playback.jumps
        if jumped:
            self._forget()
        elif self._playback is None:
            self._human.forget()
            self._leave_wheel()
        self._playback = playback
        self._latest["playback"] = playback
        if not self._clients:
            return []
        more = {"forget": True} if jumped else {}
        return [_to(ALL, frame_of("playback", playback, **more))]

    # The human at the wheel

    @property
    def _driven(self) -> bool:
        return self._session.driver != NOBODY

    def _on_step(self, complete: Complete | None, now: int) -> list[Send]:
        if complete is not None:
            self._unanswered = complete
        return []

    def _mind_the_wheel(self, now: int) -> list[Send]:
        """Answer the step that is open; and where nobody drives a human's game, stay and pause it."""
        playing = self._human.episode
        if playing is None:
            self._unanswered = None
            return []
        if not self._driven and self._grace_until is not None:
            if now < self._grace_until:
                return []
            self._grace_until = None
        sends: list[Send] = []
        if self._unanswered is not None:
            complete, self._unanswered = self._unanswered, None
            sends += answer(complete, self._session.keys.take() if self._driven else "stay")
        if not self._driven and not self._session.hold and not self._pause_asked:
            self._pause_asked = True
            sends.append(Publish("control", Control(stamp=now, action="pause")))
        return sends

    def _leave_wheel(self) -> None:
        self._session.take_wheel(NOBODY)
        self._grace_until = None
        self._stale.add("session")

    def _is_on(self, number: int | None = None) -> bool:
        """Whether a game, or this one, is set up or running."""
        episode = self._episode
        return episode is not None and episode.phase in ("setup", "running") and number in (None, episode.episode)

    # The pages

    def _on_captured(self, captured: Captured, now: int) -> list[Send]:
        value = captured.value
        if isinstance(value, Refusals):
            self._refused.add(value.counts, now)
            return []
        if not isinstance(value, PageEvent):  # the server came up, or is gone and its pages with it
            self._without_server = captured.error
            self._clients.clear()
            self._leave_wheel()
            return []
        if not value.here:
            return self._on_gone(value.client)
        if value.request is None:
            return self._on_come(value.client, now)
        if value.client not in self._clients:
            return []
        try:
            return self._on_request(value.client, value.request, now)
        except wishes.Refused as refused:
            return [_to(value.client, notice(str(refused), refused.level))]

    def _on_come(self, client: int, now: int) -> list[Send]:
        self._clients.add(client)
        first = [key for key in ("episode", "playback") if key in self._latest]
        frames = [frame("welcome", {"client": client, **self._about})]
        frames += [self._frame_of(key) for key in (*first, *(key for key in self._latest if key not in first))]
        if (paths := self._driven_paths.frame()) is not None:
            frames.append(paths)
        # What is stale goes to every page after this.
        frames += [make(now) for key, make in self._own.items() if key not in self._stale]
        return [_to(client, data) for data in frames]

    def _on_gone(self, client: int) -> list[Send]:
        self._clients.discard(client)
        self._predictions.forget_client(client)
        if self._session.driver == client:
            self._leave_wheel()
        return []

    def _on_request(self, client: int, request: requests.AnyRequest, now: int) -> list[Send]:
        match request:
            case requests.Drive():
                return self._on_drive(client, request)
            case requests.Predict(goal=goal):
                return self._predictions.want(client, goal)
            case requests.Views():
                return [_to(client, data) for data in self._past.frames(request)]
        control = wishes.control_for(request, self._situation(client, request), now)
        if not self._controls.take(now / SECOND):
            raise wishes.Refused("too much is asked at once: try again in a second")
        if isinstance(request, requests.Start):
            self._session.take_wheel(client if request.hider == HUMAN else NOBODY)
        elif isinstance(request, requests.Resume) and self._human.episode is not None and not self._driven:
            self._session.take_wheel(client)
        self._stale.add("session")
        sends: list[Send] = [Publish("control", control)]
        if isinstance(request, requests.Start) and self._reports.is_silent("referee", now):
            warning = "the referee is silent: the games begin when it is back, if at all"
            sends.append(_to(client, notice(warning, "warning")))
        return sends

    def _on_drive(self, client: int, request: requests.Drive) -> list[Send]:
        if self._human.episode is None:
            return []
        if not self._driven:
            self._session.take_wheel(client)
            self._stale.add("session")
        if self._session.driver != client:
            raise wishes.Refused("somebody drives at another page")
        (self._session.keys.press if request.held else self._session.keys.release)(request.primitive)
        return []

    def _situation(self, client: int, request: requests.AnyRequest) -> wishes.Situation:
        number = request.episode if isinstance(request, requests.Discard) else 0
        return wishes.Situation(
            replayed=self._playback is not None,
            driven_elsewhere=self._human.episode is not None and self._session.driver not in (NOBODY, client),
            can_pause=self._is_on() or self._session.more_games,
            paused=self._session.paused or self._pause_asked,
            can_discard=self._score.knows(number) or self._is_on(number),
        )

    def _on_time(self, now: int) -> list[Send]:
        if now < self._next_second:
            return []
        self._next_second = now + SECOND
        self._refused.forget_old(now)
        self._stale |= {"services", "recording"}
        return []


def _to(client: int, data: bytes) -> Write:
    return Write(PAGE, addressed(client, data))
