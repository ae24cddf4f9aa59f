"""How long a whole value map takes: 121 goals, N = 10, T = 100, VPT-TOB + VPN, from the request to its answer.

    python -m benchmarks.value_map

Ours against the plain loop that renders and computes every (path, horizon) of the same request with the same networks and batch
size, in one run. The work is that of a planner at the start of a game in a random layout, every goal taken as reachable.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field

import numpy as np
import torch
import tyro
from numpy.typing import NDArray

from schemas import PredictReply, PredictRequest
from services.predictor.core import PredictorCore, PredictorSettings
from vantage.networks.inference import Inference
from vantage.networks.inputs import render_inputs
from vantage.networks.vpn import Vpn
from vantage.networks.vpt_tob import VptTob
from vantage.service import Answer, Asked, Woken
from vantage.world import search
from vantage.world.arena import GOALS

LIMIT = 2.0  # s, must be met
GOAL = 1.4  # s, the paper on a GPU


@dataclass(frozen=True)
class Settings:
    """Time a value map."""

    predictor: tyro.conf.OmitArgPrefixes[PredictorSettings] = field(default_factory=PredictorSettings)
    rounds: int = 5
    """Maps, each from another place; the median counts."""
    steps: int = 100
    """T."""
    interval: int = 10
    """N."""
    untrained: bool = False
    """Use untrained networks of the preset `paper`, where there are no weights."""


def make_request(seed: int, steps: int, interval: int) -> PredictRequest:
    """Return what a planner asks who sees no obstacle: paths to all 121 goals from a random place."""
    generator = np.random.default_rng(seed)
    x, y = generator.uniform(0.15, 1.05, 2)
    tree = search.shortest_path_tree(np.zeros((search.CELLS, search.CELLS), np.bool_), x, y, 0, True)
    paths = [search.roll_out(x, y, 0, search.path_to(tree, *goal), steps)[:steps, :2] for goal in GOALS]
    return PredictRequest(
        stamp=0,
        state_image=generator.integers(0, 5, (128, 128), dtype=np.uint8).tobytes(),
        path_count=len(paths),
        path_steps=steps,
        paths=np.stack(paths).astype(np.float32).tobytes(),
        horizons=tuple(range(interval - 1, steps, interval)),
    )


def ask(core: PredictorCore, request: PredictRequest) -> tuple[PredictReply, float]:
    """Return the core's answer and the seconds it took."""
    started = time.perf_counter()
    core.step(Asked("predictor", request, 1), time.time_ns())
    while core.wake_at() is not None:
        for send in core.step(Woken(), time.time_ns()):
            if isinstance(send, Answer):
                assert isinstance(send.reply, PredictReply)
                return send.reply, time.perf_counter() - started
    raise RuntimeError("no answer")


def ask_plainly(networks: Inference, request: PredictRequest) -> tuple[NDArray[np.float32], float]:
    """Return the answer computed query by query, nothing shared, and the seconds it took."""
    started = time.perf_counter()
    view = np.frombuffer(request.state_image, np.uint8).reshape(1, 128, 128)
    positions = np.frombuffer(request.paths, np.float32).reshape(-1, 2)
    pairs = [(path * request.path_steps, horizon) for path in range(request.path_count) for horizon in request.horizons]
    caught = []
    for at in range(0, len(pairs), networks.batch):
        part = np.array(pairs[at : at + networks.batch], np.int64)
        zeros = np.zeros(len(part), np.int64)
        render_inputs(view, zeros, positions, part[:, 0], part[:, 1], zeros, networks.inputs[: len(part)])
        caught.append(networks.answer(zeros[:0])[0][: len(part)])
    return np.concatenate(caught).reshape(request.path_count, -1), time.perf_counter() - started


def main(settings: Settings) -> int:
    """Print the figures; returns 1 where the limit is missed."""
    batch, threads = settings.predictor.batch, settings.predictor.threads
    if settings.untrained:
        torch.manual_seed(0)
        networks = Inference(VptTob(), Vpn(), batch, threads)
    else:
        networks = Inference.of_weights(settings.predictor.weights, batch, threads)
    core = PredictorCore(networks, settings.predictor)
    core.warm_up()
    ours, plain, distinct = [], [], []
    for seed in range(settings.rounds):
        request = make_request(seed, settings.steps, settings.interval)
        reply, elapsed = ask(core, request)
        answers, plain_elapsed = ask_plainly(networks, request)
        if not np.array_equal(np.frombuffer(reply.caught, np.float32).reshape(answers.shape), answers):
            print("the answers differ", file=sys.stderr)
            return 1
        ours.append(elapsed)
        plain.append(plain_elapsed)
        distinct.append(reply.distinct)
    took, took_plainly = float(np.median(ours)), float(np.median(plain))
    pairs = request.path_count * len(request.horizons)
    print(f"{networks.device}, {networks.precision}, {networks.threads} threads, {networks.hash or 'untrained'}")
    horizons = f"{len(request.horizons)} horizons (T = {settings.steps}, N = {settings.interval})"
    print(f"value map, {request.path_count} goals x {horizons}; {np.mean(distinct):.0f} of {pairs} pairs are distinct")
    print(f"  ours        {took:6.3f} s  median of {settings.rounds}, worst {max(ours):.3f} s")
    print(f"  plain loop  {took_plainly:6.3f} s  same answers; ours takes {took / took_plainly:.2f} of it")
    print(f"  limit {LIMIT} s: {'met' if took <= LIMIT else 'MISSED'}; goal {GOAL} s: {'met' if took < GOAL else 'missed'}")
    return 0 if took <= LIMIT else 1


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
