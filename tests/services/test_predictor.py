"""The predictor: every distinct query once, the right answer to each, fairness, refusals, and no start without weights."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from schemas import PredictReply, PredictRequest
from services.predictor.__main__ import make_core
from services.predictor.batching import distinct_queries
from services.predictor.core import PredictorCore, PredictorSettings
from vantage.networks.inference import Inference
from vantage.networks.inputs import CHANNELS, render_inputs
from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.vpt_tob import VptTob, VptTobSettings
from vantage.networks.weights import card_of, save
from vantage.service import Answer, Asked, CannotStart, Publish, Refuse, Send, Woken

BATCH = 8


@pytest.fixture(scope="module")
def networks() -> Inference:
    import torch

    torch.manual_seed(0)
    return Inference(VptTob(VptTobSettings(width=0.25)), Vpn(VpnSettings(width=4)), batch=BATCH, threads=1)


def make_request(
    seed: int = 0,
    paths: int = 5,
    steps: int = 20,
    horizons: tuple[int, ...] = (4, 9, 19),
    shared: int = 8,
    views: tuple[tuple[int, int], ...] = (),
) -> PredictRequest:
    """Random paths of which the first `shared` positions are the same."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform(0.1, 1.1, (paths, steps, 2)).astype(np.float32)
    positions[:, :shared] = positions[0, :shared]
    return PredictRequest(
        stamp=seed,
        episode=3,
        step=1,
        state_image=generator.integers(0, 5, (128, 128), dtype=np.uint8).tobytes(),
        path_count=paths,
        path_steps=steps,
        paths=positions.tobytes(),
        horizons=horizons,
        views=views,
    )


def caught_of(reply: object, request: PredictRequest) -> NDArray[np.float32]:
    assert isinstance(reply, PredictReply)
    return np.frombuffer(reply.caught, np.float32).reshape(request.path_count, len(request.horizons))


def one_by_one(networks: Inference, request: PredictRequest) -> tuple[NDArray[np.float32], dict[tuple[int, int], bytes]]:
    """Every (path, horizon) rendered and computed by itself."""
    paths = np.frombuffer(request.paths, np.float32).reshape(request.path_count, request.path_steps, 2)
    view = np.frombuffer(request.state_image, np.uint8).reshape(1, 128, 128)
    zero, row = np.zeros(1, np.int64), np.empty((1, 128, 128, CHANNELS), np.uint8)
    caught, views = np.empty((request.path_count, len(request.horizons)), np.float32), {}
    for path in range(request.path_count):
        for index, horizon in enumerate(request.horizons):
            render_inputs(view, zero, paths[path], zero, np.array([horizon]), zero, row)
            networks.inputs[:] = row
            probabilities, pictures = networks.answer(zero)
            caught[path, index], views[path, index] = probabilities[0], pictures[0].tobytes()
    return caught, views


def wake_until_idle(core: PredictorCore, now: int = 0) -> list[Send]:
    sent: list[Send] = []
    while core.wake_at() is not None:
        sent += core.step(Woken(), now)
    return sent


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    paths=st.integers(1, 9),
    steps=st.integers(1, 6),
    horizons=st.lists(st.integers(0, 5), min_size=1, max_size=6),
)
def test_distinct_queries_are_those_a_dictionary_finds(seed: int, paths: int, steps: int, horizons: list[int]) -> None:
    values = np.random.default_rng(seed).integers(0, 2, (paths, steps, 2)).astype(np.float32)
    asked = np.array([min(horizon, steps - 1) for horizon in horizons])
    queries = distinct_queries(values, asked)
    expected = {(values[path, : horizon + 1].tobytes(), horizon) for path in range(paths) for horizon in asked.tolist()}
    assert len(queries) == len(expected)
    for path in range(paths):
        for index, horizon in enumerate(asked.tolist()):
            query = queries.query[path, index]
            assert queries.horizon[query] == horizon
            np.testing.assert_array_equal(values[queries.path[query], : horizon + 1], values[path, : horizon + 1])


def test_answers_and_views_are_those_of_each_query_alone(networks: Inference) -> None:
    request = make_request(views=((0, 0), (4, 2), (2, 1), (4, 2)))
    core = PredictorCore(networks)
    assert core.step(Asked("predictor", request, 7), 1_000_000_000) == (Publish("predictor/request", request),)
    answer, publish = wake_until_idle(core, 3_500_000_000)
    assert isinstance(answer, Answer) and isinstance(publish, Publish)
    reply = answer.reply
    assert isinstance(reply, PredictReply)
    assert (answer.token, publish.key, publish.message) == (7, "predictor/reply", reply)
    assert (reply.stamp, reply.episode, reply.step, reply.elapsed) == (request.stamp, 3, 1, 2.5)
    assert reply.distinct == 1 + 5 + 5
    expected, views = one_by_one(networks, request)
    np.testing.assert_array_equal(caught_of(reply, request), expected)
    assert [reply.views[0], reply.views[1], reply.views[2]] == [views[0, 0], views[4, 2], views[2, 1]]
    assert reply.views[3] == reply.views[1]


def test_concurrent_requests_share_every_batch_and_get_the_same_answers(networks: Inference) -> None:
    large, small = make_request(1, paths=30, shared=1), make_request(2, paths=1, horizons=(5,))
    core = PredictorCore(networks)
    core.step(Asked("predictor", large, 1), 0)
    core.step(Asked("predictor", small, 2), 0)
    sent = [core.step(Woken(), 0) for _ in range(3)]
    assert [send.token for send in sent[1] if isinstance(send, Answer)] == [2]  # not behind the 90 images of the other
    answers = [*sent[1], *wake_until_idle(core)]
    alone = PredictorCore(networks)
    for request, token in ((large, 1), (small, 2)):
        alone.step(Asked("predictor", request, token), 0)
        (expected,) = [send.reply for send in wake_until_idle(alone) if isinstance(send, Answer)]
        (reply,) = [send.reply for send in answers if isinstance(send, Answer) and send.token == token]
        np.testing.assert_array_equal(caught_of(reply, request), caught_of(expected, request))


def test_a_turn_computes_one_batch_at_most(networks: Inference) -> None:
    request = make_request(paths=20, shared=0)
    core = PredictorCore(networks)
    core.step(Asked("predictor", request, 1), 0)
    turns = 0
    while core.wake_at() is not None:
        core.step(Woken(), 0)
        turns += 1
    assert turns == -(-60 // BATCH) + 1


def test_the_same_request_asked_again_is_computed_once(networks: Inference) -> None:
    request = make_request()
    core = PredictorCore(networks)
    core.step(Asked("predictor", request, 1), 0)
    assert core.step(Asked("predictor", request, 2), 0) == ()
    sent = wake_until_idle(core)
    assert [send.token for send in sent if isinstance(send, Answer)] == [1, 2]
    assert sum(isinstance(send, Publish) for send in sent) == 1


def test_networks_that_fail_refuse_what_waits_and_answer_the_next(networks: Inference, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise MemoryError("no room")

    core = PredictorCore(networks, PredictorSettings())
    core.step(Asked("predictor", make_request(), 1), 0)
    with monkeypatch.context() as broken:
        broken.setattr(Inference, "answer", fail)
        (refused,) = core.step(Woken(), 0)
    assert isinstance(refused, Refuse) and refused.token == 1 and "no room" in refused.reason
    assert core.wake_at() is None and "no room" in core.trouble
    core.step(Asked("predictor", make_request(), 2), 0)
    assert any(isinstance(send, Answer) and send.token == 2 for send in wake_until_idle(core))
    assert not core.trouble


def test_an_answer_that_is_no_number_is_never_given(networks: Inference, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every goal looked blocked, and the game was aborted for "no command from the hider"."""
    answer = Inference.answer

    def spoilt(self: Inference, views: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        caught, pictures = answer(self, views)
        caught[0] = np.nan
        return caught, pictures

    core = PredictorCore(networks)
    with monkeypatch.context() as broken:
        broken.setattr(Inference, "answer", spoilt)
        core.step(Asked("predictor", make_request(), 1), 0)
        (refused,) = core.step(Woken(), 0)
    assert isinstance(refused, Refuse) and "not finite, so the weights are no good" in refused.reason
    assert "not finite" in core.trouble and core.wake_at() is None
    core.step(Asked("predictor", make_request(), 2), 0)
    assert any(isinstance(send, Answer) for send in wake_until_idle(core)) and not core.trouble


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -0.01, 1.01])
def test_a_reply_holds_probabilities(value: float) -> None:
    PredictReply(stamp=0, caught=np.array([0.0, 1.0], "<f4").tobytes())
    with pytest.raises(ValueError, match=r"caught must hold probabilities in 0..1"):
        PredictReply(stamp=0, caught=np.array([0.5, value], "<f4").tobytes())


def test_weights_that_answer_no_number_do_not_start(tmp_path: Path) -> None:
    network = VptTob(VptTobSettings(width=0.25))
    network.encoder[0].down_norm.running_var.fill_(-1.0)  # type: ignore[index, union-attr]
    for stem, each in (("vpt-tob", network), ("vpn", Vpn(VpnSettings(width=4)))):
        save(each, tmp_path / f"{stem}.safetensors", card_of(each))
    with pytest.raises(CannotStart, match="not finite, so the weights are no good"):
        make_core(PredictorSettings(weights=tmp_path, threads=1))


def test_one_core_is_one_thread(tmp_path: Path) -> None:
    """`taskset -c 0`, or a container's share: as many threads as the process may use cores, not as many as there are."""
    program = """
import os, torch
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from learning.methods.machine import Machine
from services.predictor.core import PredictorSettings
from vantage.networks.inference import Inference
from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.vpt_tob import VptTob, VptTobSettings
inference = Inference(VptTob(VptTobSettings(width=0.25)), Vpn(VpnSettings(width=4)), 64, PredictorSettings().threads)
print(inference.threads, inference._pool._max_workers, torch.get_num_threads(), Machine.fastest().threads)
"""
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=200, check=True)
    assert finished.stdout == "1 1 1 1\n"


def test_absurd_requests_are_refused_and_the_next_is_answered(networks: Inference) -> None:
    core = PredictorCore(networks, PredictorSettings(maximum_queries=100, maximum_waiting=2))
    (refuse,) = core.step(Asked("predictor", make_request(paths=40), 1), 0)
    assert isinstance(refuse, Refuse) and "120" in refuse.reason
    colourful = PredictRequest(
        stamp=0, state_image=b"\x05" * 128 * 128, path_count=1, path_steps=1, paths=b"\0" * 8, horizons=(0,)
    )
    (refuse,) = core.step(Asked("predictor", colourful, 2), 0)
    assert isinstance(refuse, Refuse) and "palette" in refuse.reason
    wild = np.array([[[np.nan, 1e38], [-np.inf, np.inf]]], np.float32)
    strange = PredictRequest(
        stamp=0, state_image=bytes(128 * 128), path_count=1, path_steps=2, paths=wild.tobytes(), horizons=(1, 1, 0)
    )
    core.step(Asked("predictor", strange, 3), 0)
    core.step(Asked("predictor", make_request(), 4), 0)
    (refuse,) = core.step(Asked("predictor", make_request(9), 5), 0)
    assert isinstance(refuse, Refuse) and "waiting" in refuse.reason
    answers = {send.token: send.reply for send in wake_until_idle(core) if isinstance(send, Answer)}
    assert sorted(answers) == [3, 4]
    assert np.isfinite(caught_of(answers[3], strange)).all()


def test_without_weights_it_says_so_in_one_line_and_does_not_start(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "services.predictor", "--folder", str(tmp_path), "--weights", str(tmp_path / "none")]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert finished.returncode == 1
    assert finished.stderr.strip().splitlines()[-1].startswith("predictor cannot start: no weights at")
    assert "Traceback" not in finished.stderr
