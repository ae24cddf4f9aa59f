"""What networks are shown of questions: the hider's view and the plan, as pictures or as numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.methods.machine import Machine
from learning.methods.method import Questions
from schemas import STATE_IMAGE_SIZE
from vantage.networks.action_vector import VECTOR_LENGTH, render_vectors
from vantage.networks.inputs import CHANNELS, render_inputs
from vantage.perception.palette import PALETTE

Show = Callable[[Questions, NDArray[np.int64], Machine], tuple[Tensor, ...]]
"""Questions, rows [n] of them, machine -> the arguments of a network."""


def action_images(questions: Questions, rows: NDArray[np.int64], machine: Machine) -> tuple[Tensor, ...]:
    """View, F and T up to the horizon, [n, 7, 128, 128] in 0 .. 1, as VPT-TOB is shown them."""
    out = np.empty((len(rows), STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, CHANNELS), np.uint8)
    upright = np.zeros(len(rows), np.int64)
    view_of, first, horizons = questions.view_of[rows], questions.first[rows], questions.horizons[rows]
    render_inputs(questions.views, view_of, questions.positions, first, horizons, upright, out)
    return (machine.pixels(out),)


def views(questions: Questions, rows: NDArray[np.int64], machine: Machine) -> Tensor:
    """The hider's views in colour, [n, 3, 128, 128] in 0 .. 1."""
    return machine.pixels(PALETTE[questions.views[questions.view_of[rows]]])


def view_and_vector(questions: Questions, rows: NDArray[np.int64], machine: Machine) -> tuple[Tensor, ...]:
    """View [n, 3, 128, 128] in 0 .. 1, and the plan up to the horizon as numbers [n, 121]."""
    out = np.empty((len(rows), VECTOR_LENGTH), np.float32)
    first, horizons = questions.first[rows], questions.horizons[rows]
    render_vectors(questions.positions, first, horizons, np.zeros(len(rows), np.int64), out)
    return views(questions, rows, machine), torch.from_numpy(out).to(machine.device, machine.precision)
