"""A match on a bus: it knows its own games by their request alone, asks again for what is missing, and heeds who stops it."""

from __future__ import annotations

import time
from contextlib import nullcontext

import pytest

from schemas import Control, Episode, Players
from vantage import play
from vantage.bus import InProcessBus, InProcessNetwork, Sample
from vantage.deployment import DeploymentError
from vantage.match import DELIVERY, PATIENCE, REPEAT, Game, Match, sentence, wish


class Referee:
    """Answers by hand."""

    def __init__(self, network: InProcessNetwork) -> None:
        self.network = network
        self.come()

    def come(self) -> None:
        self.bus: InProcessBus = self.network.session("referee")
        self.bus.subscribe("control")

    def asked(self) -> list[Control]:
        """Return what was asked for since the last time."""
        heard = []
        while (event := self.bus.receive(0.0)) is not None:
            if isinstance(event, Sample):
                heard.append(event.decode())
        return heard  # type: ignore[return-value]

    def say(self, number: int, phase: str, request: str, seed: int = 77, **how: object) -> None:
        self.bus.publish(
            "episode",
            Episode(stamp=1, episode=number, seed=seed, phase=phase, request=request, **how),  # type: ignore[arg-type]
        )


class Asked:
    """A match of some games of seed 77 that has asked for them."""

    def __init__(self, games: int = 2) -> None:
        self.network = InProcessNetwork()
        self.referee = Referee(self.network)
        self.match = Match(self.network.session("command-line"), wish(77, games, 10, 0.25, "random", Players()))
        self.settle()
        (self.control,) = self.referee.asked()

    def settle(self) -> None:
        while self.match.turn(0.0):
            pass

    def wait_for_wish(self) -> Control:
        end = time.monotonic() + REPEAT + 5.0
        while not (heard := self.referee.asked()):
            self.match.turn(0.0)
            time.sleep(0.01)
            assert time.monotonic() < end
        return heard[0]


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_games_of_others_are_not_taken_for_ones_own_whatever_their_seed(asked: Asked) -> None:
    for request in ("", "another"):
        for phase in ("setup", "running", "ended"):
            asked.referee.say(3, phase, request)
    asked.settle()
    assert asked.match.games == [] and asked.match.current is None
    for phase in ("setup", "running", "ended"):
        asked.referee.say(4, phase, asked.control.request)
    asked.settle()
    assert [game.episode.episode for game in asked.match.games] == [4]


def test_a_request_that_was_not_heard_is_made_again_by_the_same_name(asked: Asked) -> None:
    again = asked.wait_for_wish()
    assert (again.request, again.seed, again.games) == (asked.control.request, 77, 2)


def test_of_a_restarted_referee_the_rest_is_asked_for(asked: Asked) -> None:
    request = asked.control.request
    for phase in ("setup", "running"):
        asked.referee.say(1, phase, request)
    asked.settle()
    asked.referee.bus.close()
    asked.settle()
    assert [game.episode.reason for game in asked.match.games] == ["the referee died"]
    asked.referee.come()
    rest = asked.wait_for_wish()
    assert (rest.request, rest.seed, rest.games) == (request, 78, 1)


@pytest.mark.parametrize(
    ("others", "ended"),
    [
        (Control(stamp=1, action="stop"), "somebody has stopped them"),
        (Control(stamp=1, action="stop", reason="`vantage stop`"), "`vantage stop`"),
        (Control(stamp=1, action="start", request="another"), "somebody has asked for other games"),
        (Control(stamp=1, action="stop", request="another"), ""),
        (Control(stamp=1, action="pause"), ""),
    ],
)
def test_who_stops_the_games_ends_the_match(asked: Asked, others: Control, ended: str) -> None:
    asked.network.session("console").publish("control", others)
    asked.settle()
    assert (asked.match.ended_early, asked.match.over) == (ended, bool(ended))


def test_a_match_is_over_when_the_stopped_game_has_ended(asked: Asked) -> None:
    asked.referee.say(1, "setup", asked.control.request)
    asked.network.session("console").publish("control", Control(stamp=1, action="stop"))
    asked.settle()
    assert not asked.match.over
    asked.referee.say(1, "aborted", asked.control.request)
    asked.settle()
    assert asked.match.over and len(asked.match.games) == 1


def test_stopping_stops_no_games_but_its_own(asked: Asked) -> None:
    asked.referee.say(1, "setup", asked.control.request)
    asked.settle()
    asked.match.stop("enough")
    (control,) = asked.referee.asked()
    assert (control.action, control.request, control.reason) == ("stop", asked.control.request, "enough")


def wait_past_the_patience(asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    late = time.monotonic() + PATIENCE + 1.0
    with monkeypatch.context() as patched:
        patched.setattr("vantage.match.time.monotonic", lambda: late)
        asked.match.turn(0.0)


def test_a_pause_before_the_first_game_is_not_taken_for_a_referee_that_does_nothing(
    asked: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    console = asked.network.session("console")
    console.publish("control", Control(stamp=1, action="pause"))
    asked.settle()
    wait_past_the_patience(asked, monkeypatch)
    console.publish("control", Control(stamp=1, action="resume"))
    asked.settle()
    with pytest.raises(DeploymentError, match="no game was set up"):
        wait_past_the_patience(asked, monkeypatch)


@pytest.mark.parametrize("paused", [True, False])
def test_a_pause_that_outlasts_a_game_does_not_end_the_match(asked: Asked, monkeypatch: pytest.MonkeyPatch, paused: bool) -> None:
    for phase in ("setup", "running", "ended"):
        asked.referee.say(1, phase, asked.control.request, paused=paused and phase == "ended")
    asked.settle()
    with nullcontext() if paused else pytest.raises(DeploymentError, match="no game was set up"):
        wait_past_the_patience(asked, monkeypatch)


def test_a_stop_before_the_first_game_has_time_to_be_delivered(asked: Asked) -> None:
    began = time.monotonic()
    asked.match.stop("enough")
    assert time.monotonic() - began >= DELIVERY
    assert [control.action for control in asked.referee.asked()] == ["stop"]


@pytest.mark.parametrize(
    ("episode", "goal", "expected"),
    [
        ({"outcome": "survived", "step": 1}, 0, "the hider survived 1 step, planned in 0.50 s, goal (0.10, 0.10) m"),
        ({"outcome": "survived", "step": 20}, 112, "the hider survived 20 steps, planned in 0.50 s, goal (0.30, 1.10) m"),
        ({"outcome": "caught", "step": 9, "caught_step": 9}, None, "the hider was caught at step 9, planned in 0.50 s"),
        ({"phase": "aborted", "step": 3, "reason": "\x1b[31mno"}, 5, "aborted at step 3: [31mno"),
    ],
)
def test_a_game_is_told_in_one_line(episode: dict[str, object], goal: int | None, expected: str) -> None:
    game = Episode(**{"stamp": 1, "episode": 4, "seed": 7, "phase": "ended", **episode})  # type: ignore[arg-type]
    assert sentence(Game(game, 0.5, goal)) == f"game 4 (seed 7): {expected}"


def test_detached_games_that_were_stopped_are_no_success(asked: Asked) -> None:
    asked.network.session("console").publish("control", Control(stamp=1, action="stop", reason="enough"))
    with pytest.raises(DeploymentError, match="stopped: enough"):
        play._detach(asked.match, play.Settings(detach=True), "")
