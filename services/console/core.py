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
from services.console.human import HEARD, HUMAN
from services.console.past import PastViews
from services.console.prediction import Predictions
from services.console.rate import Shares
from services.console.refused import RefusedLately
from services.console.reports import Reports
from services.console.score import Score
from services.console.session import Session
from services.console.wheel import NOBODY, Wheel
from vantage.service import SECOND, Answered, Arrived, Captured, Publish, Received, Send, Woken, Write

OWN_CONTROLS = 4.0, 8.0
"""Messages to `control` for one page: a second, and at once."""
ALL_CONTROLS = 8.0, 16.0
"""For all pages together, but for what holds the robots (stop, pause): no page can keep another one from that."""
BACK = 0.1
"""s by which the position of one replay never goes back by itself."""


class ConsoleCore:
    """See module. Keeps the last message of each key, so that nothing is encoded while no page is there.

    Args:
        about: fields of the frame `welcome`.
    """

    declaration = DECLARATION

    def __init__(self, about: Mapping[str, Any]) -> None:
        self._about = dict(about)
        self._clients: set[int] = set()
        self._controls = Shares(OWN_CONTROLS, ALL_CONTROLS)
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
        self._wheel = Wheel()
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
        wheel = self._wheel.wake_at()
        return self._next_second if wheel is None else min(self._next_second, wheel)

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
        sends += self._wheel.mind(now)
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
            "session": lambda _: self._session.frame(self._wheel.driver),
        }

    # What the bus says

    def _on_message(self, key: str, message: Message, now: int) -> list[Send]:
        if isinstance(message, Health):
            self._reports.add(message, now)
            if message.service == "referee" and self._session.hear_referee(message.process):
                self._stale.add("session")
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
        if isinstance(message, Playback):
            return self._on_playback(message)
        self._latest[key] = message
        if isinstance(message, Episode):
            self._on_episode(message, now)
        elif isinstance(message, Plan):
            self._predictions.see_plan(message)
        elif isinstance(message, Pose):
            self._driven_paths.add(key.partition("/")[0], message)
        elif isinstance(message, StateImage) and key == "seeker/view":
            self._past.add(message)
        if key in HEARD and self._playback is None:
            self._wheel.add(key, message)
        return self._show(key)

    def _show(self, key: str) -> list[Send]:
        return [_to(ALL, self._frame_of(key))] if self._clients and key in self._latest else []

    def _frame_of(self, key: str) -> bytes:
        message = self._latest[key]
        if isinstance(message, Plan):
            return frame_of(key, message, unpredictable=self._predictions.unpredictable)
        return frame_of(key, message)

    def _on_episode(self, episode: Episode, now: int) -> None:
        before, self._episode = self._episode, episode
        another = before is None or before.episode != episode.episode
        # A referee that counts anew, or another log, uses a number again.
        again = before is not None and not another and (before.seed != episode.seed or _is_set_up_again(before, episode))
        if another or again:
            self._put_away_but(None if again else episode.episode)
        self._score.add(episode)
        self._session.see(episode, self._score.is_discarded(episode.episode))
        self._stale |= {"score", "session"}
        if self._playback is None:
            self._wheel.see(episode, another or again, now)

    def _put_away_but(self, number: int | None) -> None:
        """Put away what is known of games but for one."""
        self._latest = {
            key: message
            for key, message in self._latest.items()
            if message.episode == number or key in ("episode", "playback", "hider/track", "seeker/track")
        }
        if number is None:
            self._past.forget()
            self._driven_paths.forget()
            self._predictions.forget()
        else:
            self._predictions.begin(number)

    def _on_control(self, control: Control) -> list[Send]:
        if control.action == "discard" and self._can_discard(control.episode):
            self._score.discard(control.episode)
        self._session.hear(control)
        self._wheel.hear(control)
        self._stale |= {"score", "session"}
        return []

    def _on_playback(self, playback: Playback) -> list[Send]:
        jumped = self._playback is not None and _jumped(self._playback, playback)
        if jumped:
            self._forget()
        elif self._playback is None:
            self._wheel.forget()
            self._stale.add("session")
        self._playback = playback
        self._latest["playback"] = playback
        if not self._clients:
            return []
        more = {"forget": True} if jumped else {}
        return [_to(ALL, frame_of("playback", playback, **more))]

    def _can_discard(self, number: int) -> bool:
        """Whether a game can be taken back: it is the last one that was spoken of, or one that was counted."""
        last = self._episode is not None and self._episode.episode == number and not self._score.is_discarded(number)
        return last or self._score.knows(number)

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
        self._controls.forget(client)
        if self._wheel.driver == client:
            self._leave_wheel()
        return []

    def _leave_wheel(self) -> None:
        self._wheel.leave()
        self._stale.add("session")

    def _on_request(self, client: int, request: requests.AnyRequest, now: int) -> list[Send]:
        match request:
            case requests.Drive():
                if self._wheel.drive(client, request):
                    self._stale.add("session")
                return []
            case requests.Predict(goal=goal):
                return self._predictions.want(client, goal)
            case requests.Views():
                return [_to(client, data) for data in self._past.frames(request)]
        control = wishes.control_for(request, self._situation(client, request), now)
        if not self._controls.take(client, now / SECOND, urgent=isinstance(request, requests.Stop | requests.Pause)):
            raise wishes.Refused("too much is asked at once: try again in a second")
        if isinstance(request, requests.Start):
            self._wheel.take(client if request.hider == HUMAN else NOBODY)
        elif isinstance(request, requests.Resume) and self._wheel.in_game and not self._wheel.driven:
            self._wheel.take(client)
        self._stale.add("session")
        sends: list[Send] = [Publish("control", control)]
        if isinstance(request, requests.Start) and self._reports.is_silent("referee", now):
            warning = "the referee is silent: the games begin when it is back, if at all"
            sends.append(_to(client, notice(warning, "warning")))
        return sends

    def _situation(self, client: int, request: requests.AnyRequest) -> wishes.Situation:
        episode, wheel, more = self._episode, self._wheel, self._session.more_games
        return wishes.Situation(
            replayed=self._playback is not None,
            driven_elsewhere=wheel.driver not in (NOBODY, client) and (wheel.in_game or more),
            can_pause=more or (episode is not None and episode.phase in ("setup", "running")),
            paused=self._session.paused or wheel.pause_asked,
            can_discard=isinstance(request, requests.Discard) and self._can_discard(request.episode),
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


def _is_set_up_again(before: Episode, episode: Episode) -> bool:
    return episode.phase == "setup" and before.phase != "setup"


def _jumped(before: Playback, playback: Playback) -> bool:
    """Whether a replay went to another place, or is another replay than before."""
    other = (before.jumps, before.log) != (playback.jumps, playback.log)
    return other or playback.position < before.position - BACK or (before.state == "ended") > (playback.state == "ended")
