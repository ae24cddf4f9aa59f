"""Hazards, caught probabilities and the loss against their definitions, interval by interval."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from vantage.networks.hazard import Hazard, HazardSettings, caught_probability, survival_loss

SMALL = HazardSettings(encoder=(4,) * 8, reduced=4, hidden=8)


def drawn(seed: int, batch: int, checkpoints: int) -> tuple[np.random.Generator, torch.Tensor]:
    generator = np.random.default_rng(seed)
    return generator, torch.from_numpy(generator.normal(-1.0, 2.0, (batch, checkpoints)))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), checkpoints=st.integers(1, 20))
def test_being_caught_is_not_surviving_every_interval(seed: int, checkpoints: int) -> None:
    _, logits = drawn(seed, 5, checkpoints)
    found = caught_probability(logits).numpy()
    hazard = 1 / (1 + np.exp(-logits.numpy()))
    for row, of_row in zip(found, hazard, strict=True):
        survived = 1.0
        for probability, h in zip(row, of_row, strict=True):
            survived *= 1 - h
            assert abs(probability - (1 - survived)) < 1e-9
    assert (np.diff(found, axis=1) >= 0).all()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_the_loss_is_minus_the_log_likelihood_of_what_is_known(seed: int) -> None:
    generator, logits = drawn(seed, 8, 6)
    caught_in = generator.integers(0, 7, 8)  # interval of the catch, 6 = survived
    known_to = generator.integers(0, 7, 8)
    index = np.arange(6)
    caught, known = index >= caught_in[:, None], index < known_to[:, None]
    hazard = 1 / (1 + np.exp(-logits.numpy()))
    total = 0.0
    for h, catch, end in zip(hazard, caught_in, known_to, strict=True):
        likelihood = np.prod(1 - h[: min(catch, end)])
        if catch < end:
            likelihood *= h[catch]
        total -= np.log(likelihood)
    found = survival_loss(logits, torch.from_numpy(caught), torch.from_numpy(known))
    assert abs(float(found) - total / 8) < 1e-9


def test_what_is_not_known_is_not_learnt_from() -> None:
    _, logits = drawn(0, 4, 5)
    logits.requires_grad_()
    caught, known = torch.zeros(4, 5, dtype=torch.bool), torch.zeros(4, 5, dtype=torch.bool)
    known[:, :2] = True
    caught[0, 1:] = True
    survival_loss(logits, caught, known).backward()
    assert logits.grad is not None
    assert (logits.grad[:, 2:] == 0).all() and (logits.grad[:, :2] != 0).all()


def test_the_network_says_one_hazard_a_checkpoint() -> None:
    assert Hazard(SMALL)(torch.rand(2, 7, 128, 128)).shape == (2, 20)
