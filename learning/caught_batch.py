"""What the networks that say "caught" themselves learn from: rendered samples, with the outcome of their plans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from learning.dataset import Dataset, Samples
from schemas import STATE_IMAGE_SIZE
from vantage.networks.action_vector import VECTOR_LENGTH, render_vectors
from vantage.networks.coordinate_value import CoordinateValue
from vantage.networks.hazard import Hazard
from vantage.networks.hazard_attention import HazardAttention
from vantage.networks.inputs import CHANNELS, render_inputs, render_targets


def plan_labels(
    data: Dataset, samples: Samples, checkpoints: int = 20, spacing: int = 10
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return v at the checkpoints k = 1 .. K, k * spacing - 1 steps after t0, and whether it is known there. Both [B, K].

    It is known where the plan in force reaches and the game would have gone on: a catch past that counts no more than an
    escape, or catches would be seen more often than they happen.
    """
    steps = spacing * np.arange(1, checkpoints + 1) - 1
    caught = data.caught(samples.episode[:, None], samples.start[:, None] + steps)
    return caught, steps <= data.longest_horizon(samples.episode, samples.start)[:, None]


@dataclass(frozen=True)
class Batch:
    """Rendered samples: what a network is shown, and what it is to say."""

    images: NDArray[np.uint8]  # [B, 128, 128, C]: hazard, view, F and T of the whole plan; others, the view
    vectors: NDArray[np.float32]  # [B, 121], hazard-attention: of the whole plan; [B, 0] for the hazard network
    caught: NDArray[np.bool_]  # [B, K] at the checkpoints, or [B, 1] at the horizon
    known: NDArray[np.bool_]  # as `caught`
    samples: Samples


def render(network: Hazard | HazardAttention | CoordinateValue, data: Dataset, samples: Samples) -> Batch:
    """Render samples as the network is shown them."""
    if isinstance(network, CoordinateValue):
        images, vectors = _view_and_vector(data, samples)
        return Batch(images, vectors, samples.caught[:, None], np.ones((len(samples), 1), np.bool_), samples)
    shape = network.settings
    reach = shape.checkpoints * shape.spacing - 1  # longer games have longer plans
    longest = np.minimum(data.longest_horizon(samples.episode, samples.start), reach)
    whole = replace(samples, horizon=longest)
    caught, known = plan_labels(data, samples, shape.checkpoints, shape.spacing)
    if isinstance(network, HazardAttention):
        return Batch(*_view_and_vector(data, whole), caught, known, samples)
    plans = data.questions(whole)
    images = np.empty((len(samples), STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, CHANNELS), np.uint8)
    render_inputs(plans.views, plans.view_of, plans.positions, plans.first, plans.horizons, samples.symmetry, images)
    return Batch(images, np.empty((len(samples), 0), np.float32), caught, known, samples)


def _view_and_vector(data: Dataset, samples: Samples) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return the views in colour [B, 128, 128, 3] and the plans up to the horizons as numbers [B, 121]."""
    asked = data.questions(samples)
    images = np.empty((len(samples), STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, 3), np.uint8)
    render_targets(asked.views[asked.view_of], samples.symmetry, images, np.empty(images.shape[:3], np.bool_))
    vectors = np.empty((len(samples), VECTOR_LENGTH), np.float32)
    render_vectors(asked.positions, asked.first, asked.horizons, samples.symmetry, vectors)
    return images, vectors
