"""The referee tells why a game was given up: whose fault it is, in that service's own words."""

from schemas import Episode, Rules
from services.referee import reasons
from services.referee.core import RefereeCore, RefereeSettings
from tests.services.referee_table import REAL, Table, trouble
from vantage.service import SECOND, Changed, Woken


def aborted_at_the_first_step(*received: object) -> str:
    """Play up to step 0 on a real table, receive some events, and never see the next poses; return the reason."""
    table = Table(autoplay=True, games=1)
    table.core = RefereeCore(RefereeSettings(autoplay=True, games=1, rules=Rules(step_period=0.0), required=REAL))
    table.wake()
    table.wake()
    for name in ("tracker", "robot", "seeker", "planner"):
        table.send(Changed(name, True))
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    for event in received:
        table.send(event)
    table.command("hider", 0)
    table.command("seeker", 0)
    (aborted,) = table.wait(*received)
    assert isinstance(aborted, Episode) and aborted.phase == "aborted" and aborted.outcome == "undecided"
    return aborted.reason


def test_an_aborted_game_says_what_those_who_embody_the_robots_complain_of() -> None:
    late = "step 0 was not executed within 10 s"
    assert aborted_at_the_first_step() == late
    lost = trouble("tracker", "overhead camera: no frame for 2.0 s")
    said = aborted_at_the_first_step(trouble("tracker", "no picture"), lost)
    assert said == f"{late}; tracker: overhead camera: no frame for 2.0 s"
    assert aborted_at_the_first_step(lost, trouble("tracker", "", "ok")) == late


def test_a_long_complaint_leaves_room_for_another() -> None:
    reason = aborted_at_the_first_step(trouble("tracker", "x" * 500), trouble("robot", "the seeker does not answer"))
    assert reason.endswith("xxx…; robot: the seeker does not answer") and len(reason) <= 200


def test_a_reason_is_never_cut_in_mid_word() -> None:
    words = "robot hider does not answer on hider.tty: is it switched on, is it the right port?"
    for count in range(1, 60):
        told = [trouble(service, " ".join([*["so"] * count, words, words])) for service in ("tracker", "robot")]
        reason = aborted_at_the_first_step(*told)
        assert len(reason) <= 200 and reason.endswith(("…", "?"))
        known = f"{words} so step 0 was not executed within 10 s tracker robot".split()
        assert {word.rstrip("…;:,?") for word in reason.split()} <= {word.rstrip("?,:") for word in known}


def test_a_machine_that_is_too_slow_is_waited_for_and_named() -> None:
    slow = "this machine is too slow: it draws 2.1 of 20 pictures a second from above; load 12.0 on 2 cores: stop other programs"
    table = Table(autoplay=True, games=1)
    table.core = RefereeCore(RefereeSettings(autoplay=True, games=1, rules=Rules(step_period=0.0), required=REAL))
    table.wake()
    table.wake()
    for name in ("tracker", "robot", "seeker", "planner"):
        table.send(Changed(name, True))
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    table.send(trouble("rehearsal", slow))
    table.send(trouble("robot", "something else"))
    table.command("hider", 0)
    table.command("seeker", 0)
    began = table.now
    while table.now < began + 18 * SECOND:
        assert table.wake() == []
    table.pose("hider", 0.2, 1)
    table.pose("seeker", 0.6, 1)
    table.command("hider", 1)
    table.command("seeker", 1)
    ended: list[object] = []
    while not ended:
        ended = table.wake()
    (aborted,) = ended
    assert isinstance(aborted, Episode) and aborted.phase == "aborted"
    assert "; rehearsal: this machine is too slow: it draws 2.1 of 20 pictures" in aborted.reason


def test_time_in_which_the_referee_did_not_run_counts_against_nobody() -> None:
    table = Table(autoplay=True, games=1)
    table.core = RefereeCore(RefereeSettings(autoplay=True, games=1, rules=Rules(step_period=0.0), required=REAL))
    table.wake()
    table.wake()
    for name in ("tracker", "robot", "seeker", "planner"):
        table.send(Changed(name, True))
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    table.command("hider", 0)
    table.command("seeker", 0)
    table.now += 9 * SECOND
    table.core.held_up(9 * SECOND, table.now)
    assert table.send(Woken()) == []
    assert not any(isinstance(message, Episode) and message.phase == "aborted" for message in table.pose("hider", 0.2, 1))
    table.pose("seeker", 0.6, 1)
    assert table.core.wake_at() is not None


def test_who_is_gone_is_named_and_its_last_words_are_not_believed() -> None:
    reason = aborted_at_the_first_step(trouble("robot", "all is well"), Changed("robot", False))
    assert reason == "step 0 was not executed within 20 s; simulator or robot or onboard is not alive"


def test_the_first_commands_are_waited_for_longer_on_a_machine_that_is_too_slow() -> None:
    """Its planner may have to compile what it runs, which takes it a minute then."""
    table = Table(autoplay=True, games=1)
    table.core = RefereeCore(RefereeSettings(autoplay=True, games=1, required=REAL))
    table.wake()
    table.wake()
    for name in ("tracker", "robot", "seeker", "planner"):
        table.send(Changed(name, True))
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    table.send(trouble("tracker", "this machine is too slow: tracker ran up to 0.9 s late"))
    began = table.now
    while table.now < began + 100 * SECOND:
        assert table.wake() == []
    ended: list[object] = []
    while not ended:
        ended = table.wake()
    (aborted,) = ended
    assert isinstance(aborted, Episode) and aborted.phase == "aborted"
    assert aborted.reason.startswith("no command from the hider or the seeker for step 0; tracker: this machine is too slow")


def test_the_reason_of_a_stop_is_not_cut_in_mid_word() -> None:
    reason = reasons.stopped("enough " * 60)
    assert len(reason) <= 200 and reason.endswith(" enough…")
