"""The attention hazard network: later steps do not change earlier hazards, and it finds the seeker in the view."""

import numpy as np
import torch

from vantage.networks.action_vector import SLOTS, VECTOR_LENGTH
from vantage.networks.hazard_attention import HazardAttention, HazardAttentionSettings
from vantage.perception.palette import FREE, OTHER, PALETTE

SMALL = HazardAttentionSettings(encoder=(4,) * 8, size=16, heads=2, layers=2)


def plans(batch: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    vector = torch.zeros(batch, VECTOR_LENGTH)
    slots = vector[:, :-1].view(batch, SLOTS, 3)
    slots[:, :20, :2] = torch.rand(batch, 20, 2, generator=generator) * 2 - 1
    slots[:, :20, 2] = 1.0
    return vector


def view_with_seeker(x: float, y: float) -> torch.Tensor:
    """x, y in -1..1; a disc of 7 pixels' radius on free ground. [1, 3, 128, 128]"""
    rows, columns = np.mgrid[0:128, 0:128]
    disc = np.hypot(columns + 0.5 - 64 * (x + 1), rows + 0.5 - 64 * (1 - y)) <= 7
    image = np.where(disc, OTHER, FREE)
    return torch.from_numpy(PALETTE[image].transpose(2, 0, 1).copy())[None].float() / 255


def test_what_the_hider_does_later_changes_no_earlier_hazard() -> None:
    torch.manual_seed(0)
    network = HazardAttention(SMALL).eval()
    view, one = view_with_seeker(0.3, -0.2), plans(1, 1)
    other = one.clone()
    other[:, 3 * 12 : 3 * 20] = plans(1, 2)[:, 3 * 12 : 3 * 20]  # from slot 12 on
    with torch.no_grad():
        first, second = network(view, one), network(view, other)
    torch.testing.assert_close(first[:, :12], second[:, :12])
    assert (first[:, 12:] - second[:, 12:]).abs().max() > 1e-4


def test_the_seeker_is_found_where_the_view_shows_it() -> None:
    network = HazardAttention(SMALL)
    for x, y in ((0.3, -0.2), (-0.7, 0.6), (0.0, 0.0)):
        centre, visible = network._seeker(view_with_seeker(x, y))
        assert visible.item() == 1
        assert np.hypot(*(centre[0].numpy() - (x, y))) < 0.01
    nobody = torch.from_numpy(PALETTE[np.full((128, 128), FREE)].transpose(2, 0, 1).copy())[None].float() / 255
    centre, visible = network._seeker(nobody)
    assert visible.item() == 0 and centre.abs().max() == 0


def test_features_are_taken_where_the_plan_goes() -> None:
    """A change of the view near one place of the plan changes what that token samples, and mirrored places do not mix."""
    from vantage.networks.hazard_attention import _sampled

    image = torch.zeros(1, 1, 32, 32)
    image[0, 0, 4, 25] = 1.0  # far side, right: x = 25.5 / 16 - 1, y = 1 - 4.5 / 16
    places = torch.tensor([[[25.5 / 16 - 1, 1 - 4.5 / 16], [25.5 / 16 - 1, -(1 - 4.5 / 16)], [-(25.5 / 16 - 1), 1 - 4.5 / 16]]])
    assert torch.allclose(_sampled(image, places)[0, :, 0], torch.tensor([1.0, 0.0, 0.0]), atol=1e-5)
