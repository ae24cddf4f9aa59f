"""Shape of the networks: the paper's layers, what an output pixel can see, and that folding changes nothing."""

import numpy as np
import pytest
import torch
from torch import nn

from learning.tensors import in_unit_range
from vantage.networks import inference
from vantage.networks.action_vector import VECTOR_LENGTH
from vantage.networks.inference import Inference, folded
from vantage.networks.vector_action import VectorAction, VectorActionSettings
from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.vpt_tob import VptTob, VptTobSettings

SMALL = VptTobSettings(width=0.25)


def convolutions(module: nn.Module) -> list[nn.Module]:
    return [layer for layer in module.modules() if isinstance(layer, nn.Conv2d)]


def test_the_preset_paper_is_the_papers_network() -> None:
    network = VptTob()
    assert len(convolutions(network.encoder)) == 8
    assert sum(isinstance(layer, nn.ConvTranspose2d) for layer in [*(up.up for up in network.ups), network.view]) == 4  # type: ignore[union-attr]
    assert sum(parameter.numel() for parameter in network.parameters()) == pytest.approx(0.57e6, rel=0.01)
    vpn = Vpn()
    kinds = [type(layer) for layer in vpn.layers]
    assert (kinds.count(nn.Conv2d), kinds.count(nn.MaxPool2d), kinds.count(nn.Linear)) == (3, 3, 2)
    assert kinds.index(nn.Dropout) > kinds.index(nn.Linear)


@pytest.mark.parametrize("settings", [SMALL, VptTobSettings(width=0.25, whole_image=True, caught_head=True)])
def test_views_are_pictures_and_the_head_is_a_logit(settings: VptTobSettings) -> None:
    network = VptTob(settings).eval()
    view, caught = network.forward_with_head(torch.rand(2, 7, 128, 128))
    assert view.shape == (2, 3, 128, 128)
    assert view.min() >= 0 and view.max() <= 1
    assert (None if caught is None else caught.shape) == ((2,) if settings.caught_head else None)
    assert Vpn()(view).shape == (2,)


def test_the_vector_action_baseline_is_vpt_tob_with_numbers_for_its_action_maps() -> None:
    torch.manual_seed(0)
    network, paper = VectorAction().eval(), VptTob()
    assert network.settings.vector == VECTOR_LENGTH
    kinds = [[type(layer) for layer in half.modules()] for half in (network.encoder, network.ups, network.coarse)]
    assert kinds == [[type(layer) for layer in half.modules()] for half in (paper.encoder, paper.ups, paper.coarse)]
    assert convolutions(network.encoder)[0].in_channels == 3  # type: ignore[union-attr]
    view, vector = torch.rand(1, 3, 128, 128), torch.rand(1, VECTOR_LENGTH)
    bottleneck = network.encode(view, vector)[0]
    embedded = bottleneck[-network.settings.embedding :]
    assert torch.equal(embedded, embedded[:, :1, :1].expand_as(embedded))  # the same at every place
    other = network(view, torch.rand(1, VECTOR_LENGTH)) - network(view, vector)
    assert (other.abs().amax(dim=(0, 1)) > 0).float().mean() > 0.99  # the plan is told to the whole picture
    small = VectorAction(VectorActionSettings(width=0.25, whole_image=True, caught_head=True))
    picture, caught = small.forward_with_head(torch.rand(2, 3, 128, 128), torch.rand(2, VECTOR_LENGTH))
    assert caught is not None and (picture.shape, caught.shape) == ((2, 3, 128, 128), (2,))


@pytest.mark.parametrize("whole", [False, True])
def test_only_the_deeper_sibling_sees_the_opposite_corner(whole: bool) -> None:
    torch.manual_seed(0)
    network = VptTob(VptTobSettings(width=0.25, whole_image=whole)).eval()
    image = torch.rand(1, 7, 128, 128, requires_grad=True)
    network(image)[0, :, 0, 0].sum().backward()
    assert image.grad is not None
    assert bool(image.grad[0, :, 112:, 112:].abs().sum() > 0) is whole


def test_folding_the_norms_changes_nothing() -> None:
    torch.manual_seed(0)
    network = VptTob(VptTobSettings(width=0.25, whole_image=True))
    with torch.no_grad():
        for _ in range(3):  # running statistics that are not the initial ones
            network(torch.rand(4, 7, 128, 128))
    network.eval()
    image = torch.rand(3, 7, 128, 128)
    plain = folded(network)
    assert not any(isinstance(layer, nn.BatchNorm2d) for layer in plain.modules())
    torch.testing.assert_close(plain(image), network(image), atol=1e-4, rtol=1e-4)


def test_what_answers_in_play_is_what_was_trained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inference, "fast_precision", lambda _: torch.float32)
    torch.manual_seed(0)
    vpt_tob, vpn = VptTob(SMALL), Vpn(VpnSettings(width=4)).eval()
    shown = np.random.default_rng(0).integers(0, [[[[10]]], [[[120]]], [[[255]]]], (3, 128, 128, 7)).astype(np.uint8)
    pixels = in_unit_range(torch.from_numpy(shown), torch.float32)
    with torch.no_grad():  # untrained networks say nearly the same of everything: make these tell the three apart
        for layer in vpt_tob.modules():
            if isinstance(layer, nn.BatchNorm2d):
                layer.momentum = 1.0
        vpt_tob(pixels)
        expected = vpt_tob.eval()(pixels)
        logits, last = vpn(expected), vpn.layers[-1]
        last.weight /= logits.std()  # type: ignore[operator]
        last.bias.copy_((last.bias - logits.mean()) / logits.std())  # type: ignore[operator,union-attr]
        probabilities = torch.sigmoid(vpn(expected)).numpy()
    assert np.ptp(probabilities) > 0.2
    network = Inference(vpt_tob, vpn, batch=3, threads=1)
    network.inputs[:] = shown
    caught, views = network.answer(np.arange(3))
    np.testing.assert_allclose(caught, probabilities, atol=0.01)
    np.testing.assert_allclose(views, expected.permute(0, 2, 3, 1).numpy() * 255, atol=0.6)
