"""A referee, and the other services' part played by hand."""

from collections.abc import Sequence

from schemas import Command, Control, Episode, Health, Pose, Rules, Tick
from services.referee.core import RefereeCore, RefereeSettings
from vantage.service import SECOND, Arrived, Changed, Publish, Send, Woken

REQUIRED = ("simulator", "seeker", "planner")


class Table:
    """Plays the other services' part by hand."""

    def __init__(self, **settings: object) -> None:
        self.core = RefereeCore(RefereeSettings(required=REQUIRED, **settings))  # type: ignore[arg-type]
        self.now = 0

    def send(self, received: object) -> list[object]:
        return messages(self.core.step(received, self.now))  # type: ignore[arg-type]

    def arrive(self) -> list[object]:
        self.wake()
        self.wake()
        sent: list[object] = []
        for name in REQUIRED:
            sent += self.send(Changed(name, True))
        return sent

    def wake(self) -> list[object]:
        wake = self.core.wake_at()
        assert wake is not None
        self.now = max(self.now, wake)
        return self.send(Woken())

    def wait(self, *each_second: object) -> list[object]:
        """Let time go by, and come in each second what services say of themselves, until the referee says something."""
        said: list[object] = []
        while not said:
            self.now += SECOND
            for received in each_second:
                self.send(received)
            said = self.send(Woken())
        return said

    def pose(self, robot: str, x: float, step: int, episode: int = 1) -> list[object]:
        return self.send(Arrived(f"{robot}/pose", Pose(stamp=self.now, episode=episode, step=step, x=x, y=0.5, heading=0.0)))

    def ask(self, action: str, **wish: object) -> list[object]:
        return self.send(Arrived("control", Control(stamp=self.now, action=action, **wish)))  # type: ignore[arg-type]

    def console_says(self) -> list[object]:
        return self.send(trouble("console", "", "ok"))

    def command(self, robot: str, step: int, episode: int = 1) -> list[object]:
        command = Command(stamp=self.now, episode=episode, step=step, primitive="stay")
        return self.send(Arrived(f"{robot}/command", command))

    def play_step(self, step: int, hider: float, seeker: float) -> list[object]:
        self.command("hider", step)
        self.command("seeker", step)
        self.pose("hider", hider, step + 1)
        return self.pose("seeker", seeker, step + 1)


def messages(sends: Sequence[Send]) -> list[object]:
    assert all(isinstance(send, Publish) for send in sends)
    return [send.message for send in sends if isinstance(send, Publish)]


def start(**settings: object) -> Table:
    rules = settings.pop("rules", Rules(step_period=0.0))
    table = Table(autoplay=True, games=1, rules=rules, **settings)
    (setup,) = table.arrive()
    assert isinstance(setup, Episode) and setup.phase == "setup" and setup.seed == 1
    table.pose("hider", 0.2, 0)
    running, tick = table.pose("seeker", 0.6, 0)
    assert isinstance(running, Episode) and running.phase == "running"
    assert tick == Tick(stamp=table.now, episode=1, step=0)
    return table


def trouble(service: str, reason: str, state: str = "degraded") -> Arrived:
    health = Health(stamp=0, service=service, state=state, process=1, uptime=1.0, reason=reason)  # type: ignore[arg-type]
    return Arrived(f"health/{service}", health)


PACED = Rules(step_period=0.25)


REAL = ("simulator|tracker", "simulator|robot|onboard", "seeker", "planner")
