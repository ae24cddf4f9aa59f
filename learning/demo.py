"""`vantage demo`: start everything, play one game, draw it, stop everything."""

from __future__ import annotations

import time
import uuid
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from rich.console import Console

from learning.picture import VIEW_INTERVAL, Game, draw, read_game
from schemas import Control, Episode, Message, Plan, Players, PredictReply, PredictRequest, StateImage, Tick
from vantage.bus import Bus, Reply, Sample
from vantage.deployment import Deployment, DeploymentError
from vantage.match import SeekerPreset, wish
from vantage.watch import HealthWatch, diagnosis
from vantage.world.arena import goal_name

console = Console(highlight=False)

_PATIENCE = 60.0
TRIES = 3
"""A game that is aborted (a machine too busy to play in real time) is asked for again."""


@dataclass(frozen=True)
class DemoSettings:
    """Play one game with all services and trained networks, record it and draw it.

    Examples:
      vantage demo
      vantage demo --seed 12 --seeker expert --layout lab
    """

    seed: int = 13
    """Seed of the game: layout, start, camera noise, exploration."""
    layout: str = "random"
    """Arena: `random`, `lab`, or the path of a layout file."""
    seeker: SeekerPreset = "glancing"
    """Preset of the seeker."""
    steps: int = 100
    """Steps that the hider has to survive."""
    period: float = 0.25
    """Seconds a step takes; 0 = as fast as possible."""
    to: Path = Path("demo")
    """Folder for the log and the picture."""
    folder: Path | None = None
    """Private runtime folder; default /tmp/vantage-USERID/simulation."""


def main(settings: DemoSettings) -> int:
    """Run the demo. Returns the exit code."""
    from vantage.bus.zenoh_bus import ZenohBus

    started = time.monotonic()
    ask = wish(settings.seed, 1, settings.steps, settings.period, settings.layout, Players(seeker=settings.seeker))
    deployment = Deployment("simulation", settings.folder)
    before = set(settings.to.glob("*.mcap"))
    console.print("1/5 starting the services ...")
    deployment.start(settings.to, {})
    try:
        with ZenohBus("command-line", deployment.folder) as bus:
            with HealthWatch(deployment) as watch:
                verdicts = watch.wait_until_healthy(_PATIENCE)
            if why := diagnosis(deployment, verdicts):
                raise DeploymentError(why)
            console.print(f"    {len(verdicts)} services are healthy after {time.monotonic() - started:.1f} s")
            for attempt in range(1, TRIES + 1):
                episode = _play(bus, ask, started)
                if episode.phase == "ended" or attempt == TRIES:
                    break
                console.print("    that game was aborted; once more")
            # What was said last is on its way to the recorder, which flushes each second.
            time.sleep(0.5)
    finally:
        deployment.stop()
    logs = sorted(set(settings.to.glob("*.mcap")) - before)
    if not logs:
        raise DeploymentError(f"the recorder left no log in {settings.to}: see {deployment.log_of('recorder')}")
    console.print("5/5 drawing the picture from the log ...")
    game: Game = read_game(logs[-1])
    picture = logs[-1].with_suffix(".png")
    draw(game, picture)
    ending = {
        "caught": f"the seeker caught the hider at step {episode.caught_step}",
        "survived": f"the hider survived all {episode.rules.maximum_steps} steps",
    }
    console.print(f"\noutcome  {ending.get(episode.outcome, f'the game was aborted: {episode.reason}')}")
    console.print(f"log      {logs[-1]}   (look inside: vantage log info {logs[-1]})", soft_wrap=True)
    console.print(f"picture  {picture}", soft_wrap=True)
    return 0 if episode.phase == "ended" else 1


def _play(bus: Bus, ask: Control, started: float) -> Episode:
    """Ask for one game, tell how it goes, ask for the predicted views of the chosen plan. Returns the game's last word."""
    ask = replace(ask, stamp=time.time_ns(), request=uuid.uuid4().hex)
    bus.subscribe("episode", "tick", "hider/plan", "hider/view")
    rules = ask.rules
    deadline = time.monotonic() + _PATIENCE
    while not bus.has_reader("control"):
        if time.monotonic() > deadline:
            raise DeploymentError("the referee does not listen to `control`: see `vantage logs referee`")
        bus.receive(0.05)
    bus.publish("control", ask)
    view: StateImage | None = None
    plan: Plan | None = None
    shown, playing, asked = 0, False, False
    while True:
        event = bus.receive(1.0)
        if time.monotonic() > deadline:
            raise DeploymentError("the game does not go on: see `vantage status`")
        if isinstance(event, Reply):
            _tell_prediction(event)
        if not isinstance(event, Sample):
            continue
        deadline = time.monotonic() + _PATIENCE
        message: Message = event.decode()
        if isinstance(message, Episode):
            if message.request != ask.request:
                continue
            if message.phase == "running":
                console.print(f"2/5 game {message.episode} begins, seed {message.seed}, layout {rules.layout}")
            elif message.phase in ("ended", "aborted"):
                console.print(f"    {message.reason}")
                return message
        elif isinstance(message, StateImage) and view is None:
            view = message
        elif isinstance(message, Plan) and plan is None:
            plan = message
            open_goals = sum(value is not None for value in plan.values)
            console.print(
                f"3/5 the hider has painted its value map in {plan.elapsed:.2f} s: {open_goals} open goals, "
                f"it chooses {'no goal' if plan.goal is None else goal_name(plan.goal)}"
            )
        elif isinstance(message, Tick):
            if message.step == 0:
                console.print(f"    first tick after {time.monotonic() - started:.1f} s")
            elif plan is not None and not playing:
                playing = True
                longest = rules.maximum_steps * rules.step_period
                console.print(f"4/5 playing, {f'at most {longest:.0f} s' if longest else 'as fast as possible'} ...")
            elif message.step // VIEW_INTERVAL > shown:
                shown = message.step // VIEW_INTERVAL
                console.print(f"    step {message.step} of {rules.maximum_steps}: the hider is free")
        if view is not None and plan is not None and not asked:
            asked = True
            bus.call("predictor", views_request(view, plan), timeout=10.0)


def views_request(view: StateImage, plan: Plan) -> PredictRequest:
    """Return the question for the predicted seeker views along a plan, every 20 steps."""
    path = np.frombuffer(plan.path, np.float32).reshape(-1, 3)[: plan.horizon, :2]
    horizons = tuple(range(VIEW_INTERVAL - 1, plan.horizon, VIEW_INTERVAL)) or (plan.horizon - 1,)
    return PredictRequest(
        stamp=view.stamp,
        episode=view.episode,
        step=view.step,
        state_image=view.data,
        path_count=1,
        path_steps=len(path),
        paths=np.ascontiguousarray(path).tobytes(),
        horizons=horizons,
        views=tuple((0, index) for index in range(len(horizons))),
    )


def _tell_prediction(event: Reply) -> None:
    if event.error:
        console.print(f"    the predicted views cannot be had: {event.error}")
        return
    reply = event.decode()
    assert isinstance(reply, PredictReply)
    caught = np.frombuffer(reply.caught, np.float32)
    console.print(f"    its risk to be caught on the way there: {caught[-1]:.0%}")
