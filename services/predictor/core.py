"""The predictor's behaviour: answers requests in slices of one batch each, shared fairly among all that wait."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas import STATE_IMAGE_SIZE, PredictReply, PredictRequest
from services.predictor.batching import DistinctQueries, distinct_queries
from services.predictor.declaration import DECLARATION
from vantage.networks.inputs import render_inputs
from vantage.perception.palette import PALETTE
from vantage.service import SECOND, Answer, Asked, Publish, Received, Refuse, Send, Unexpected, Woken

logger = logging.getLogger("vantage")


@dataclass(frozen=True)
class PredictorSettings:
    """What a predictor answers with, and how much at once."""

    weights: Path = Path(__file__).resolve().parents[2] / "weights"
    """Folder with vpt-tob.safetensors and vpn.safetensors, each with its model card."""
    batch: int = 64
    """Images computed at once; between batches the predictor listens."""
    maximum_queries: int = 16_384
    """Requests with more (path, horizon) pairs are refused."""
    maximum_waiting: int = 64
    """Requests beyond so many waiting ones are refused."""
    threads: int = 0
    """CPU threads that compute; 0 = one for each core."""


_ONE_STEP: dict[str, Any] = {"path_count": 1, "path_steps": 1, "paths": bytes(8), "horizons": (0,)}


class Networks(Protocol):
    """VPT-TOB and VPN: `vantage.networks.inference.Inference`."""

    hash: str
    batch: int
    inputs: NDArray[np.uint8]

    def answer(self, views: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]: ...


@dataclass
class _Job:
    """A request under way."""

    request: PredictRequest
    tokens: list[int]
    asked_at: int
    queries: DistinctQueries
    views: dict[int, bytes | None]  # distinct query -> its predicted view, once computed
    state_image: NDArray[np.uint8]  # [128, 128]
    positions: NDArray[np.float32]  # [paths * steps, 2]
    caught: NDArray[np.float32]  # [D]
    done: int = 0


@dataclass
class PredictorCore:
    """See the module. Pure but for the networks' buffers.

    Args:
        networks: what computes; its batch size is that of the slices.
    """

    networks: Networks
    settings: PredictorSettings = field(default_factory=PredictorSettings)

    declaration = DECLARATION

    def __post_init__(self) -> None:
        self._jobs: list[_Job] = []
        self.trouble = ""

    def warm_up(self) -> None:
        """Answer a small request to nobody: compiles kernels and fills caches before the first that counts."""
        blank = bytes(STATE_IMAGE_SIZE * STATE_IMAGE_SIZE)
        self.step(Asked("predictor", PredictRequest(stamp=0, state_image=blank, **_ONE_STEP), 0), 0)
        while self._jobs:
            self.step(Woken(), 0)

    def wake_at(self) -> int | None:
        return 0 if self._jobs else None

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Asked):
            if not isinstance(received.request, PredictRequest):
                raise Unexpected(f"{type(received.request).__name__} is not a request to the predictor")
            return self._take(received.request, received.token, now)
        if not isinstance(received, Woken):
            return ()
        finished = [job for job in self._jobs if job.done == len(job.queries)]
        if finished:  # answered one turn after their last slice, so that `now` counts it
            self._jobs = [job for job in self._jobs if job.done < len(job.queries)]
            return [send for job in finished for send in self._answers(job, now)]
        try:
            self._compute()
        except Exception as error:  # kept, these jobs would fail again at every turn
            failed, self._jobs = self._jobs, []
            reason = f"the networks failed: {type(error).__name__}: {error}"
            self.trouble = reason
            logger.exception("computing an answer failed")
            return [Refuse(token, reason) for job in failed for token in job.tokens]
        self.trouble = ""
        return ()

    def _take(self, request: PredictRequest, token: int, now: int) -> Sequence[Send]:
        for job in self._jobs:  # asked again while it is being computed, perhaps after a time-out
            if job.request == request:
                job.tokens.append(token)
                return ()
        pairs = request.path_count * len(request.horizons)
        if pairs > self.settings.maximum_queries:
            return (Refuse(token, f"{pairs} (path, horizon) pairs asked, at most {self.settings.maximum_queries} are answered"),)
        if len(self._jobs) >= self.settings.maximum_waiting:
            return (Refuse(token, f"{len(self._jobs)} requests are waiting already"),)
        # Copies, because the kernel would be compiled once more for read-only arrays.
        state_image = np.frombuffer(request.state_image, np.uint8).reshape(STATE_IMAGE_SIZE, STATE_IMAGE_SIZE).copy()
        if state_image.max() >= len(PALETTE):
            return (Refuse(token, f"the state image holds palette index {state_image.max()}, the highest is {len(PALETTE) - 1}"),)
        paths = np.frombuffer(request.paths, "<f4").reshape(request.path_count, request.path_steps, 2).copy()
        queries = distinct_queries(paths, np.array(request.horizons, np.int64))
        wanted: dict[int, bytes | None] = {int(queries.query[path, horizon]): None for path, horizon in request.views}
        positions = paths.reshape(-1, 2)
        caught = np.empty(len(queries), np.float32)
        self._jobs.append(_Job(request, [token], now, queries, wanted, state_image, positions, caught))
        return (Publish("predictor/request", request),)

    def _compute(self) -> None:
        """Compute one slice: an equal share of it for every job, what is left over for the first that can use it."""
        batch = self.networks.batch
        shares = [min(len(job.queries) - job.done, batch // len(self._jobs)) for job in self._jobs]
        for number, job in enumerate(self._jobs):
            shares[number] += min(len(job.queries) - job.done - shares[number], batch - sum(shares))
        at = 0
        rows: list[tuple[int, _Job, int]] = []  # row of the batch, whose view is wanted, as which query
        for job, share in zip(self._jobs, shares, strict=True):
            chosen = slice(job.done, job.done + share)
            render_inputs(
                job.state_image[None],
                np.zeros(share, np.int64),
                job.positions,
                job.queries.path[chosen] * job.request.path_steps,
                job.queries.horizon[chosen],
                np.zeros(share, np.int64),
                self.networks.inputs[at : at + share],
            )
            rows += [(at + query - job.done, job, query) for query in job.views if job.done <= query < job.done + share]
            at += share
        caught, views = self.networks.answer(np.array([row for row, _, _ in rows], np.int64))
        if not np.isfinite(caught[:at]).all():
            raise FloatingPointError("their answer holds numbers that are not finite, so the weights are no good: train again")
        for view, (_, job, query) in zip(views, rows, strict=True):
            job.views[query] = view.tobytes()
        at = 0
        for job, share in zip(self._jobs, shares, strict=True):
            job.caught[job.done : job.done + share] = caught[at : at + share]
            job.done += share
            at += share

    def _answers(self, job: _Job, now: int) -> list[Send]:
        request = job.request
        views = tuple(job.views[int(job.queries.query[path, horizon])] or b"" for path, horizon in request.views)
        reply = PredictReply(
            stamp=request.stamp,
            episode=request.episode,
            step=request.step,
            caught=job.caught[job.queries.query].tobytes(),
            views=views,
            weights=self.networks.hash,
            distinct=len(job.queries),
            elapsed=max(0.0, (now - job.asked_at) / SECOND),
        )
        return [*(Answer(token, reply) for token in job.tokens), Publish("predictor/reply", reply)]
