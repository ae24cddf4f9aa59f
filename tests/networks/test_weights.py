"""Weights are used only with the card that describes them; whatever else lies there is refused with a readable line."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from vantage.networks.vpn import Vpn, VpnSettings
from vantage.networks.vpt_tob import SelfPerspective, VptTob, VptTobSettings
from vantage.networks.weights import ARCHITECTURES, UnusableWeights, card_of, card_path, load, load_any, read_card, save

SMALL = VptTobSettings(width=0.25, whole_image=True, caught_head=True)


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    path = tmp_path / "vpt-tob.safetensors"
    network = VptTob(SMALL)
    card = card_of(network)
    card.preset, card.metrics, card.notes = "compact", {"loss": 0.0123456}, ["A note."]
    save(network, path, card)
    return path


def test_a_network_comes_back_as_it_was_saved(tmp_path: Path) -> None:
    network, path = VptTob(SMALL).eval(), tmp_path / "deep" / "n.safetensors"
    save(network, path, card_of(network))
    again, card = load(path, VptTob)
    assert again.settings == SMALL
    assert not again.training
    image = torch.rand(1, 7, 128, 128)
    assert torch.equal(again(image), network(image))
    assert card == read_card(path)


def test_the_card_is_readable(weights: Path) -> None:
    text = weights.with_suffix(".md").read_text()
    assert "A note." in text
    assert "0.01235" in text
    assert read_card(weights).sha256 in text


def change_card(path: Path, **changes: object) -> None:
    card = json.loads(card_path(path).read_text())
    card_path(path).write_text(json.dumps({**card, **changes}))


def other_weights(path: Path) -> None:
    network = VptTob(SMALL)
    other = path.with_name("other.safetensors")
    save(network, other, card_of(network))
    path.write_bytes(other.read_bytes())


def vpn_instead(path: Path) -> None:
    network = Vpn(VpnSettings(width=4))
    save(network, path, card_of(network))


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda path: path.unlink(), "no weights at .*train"),
        (lambda path: card_path(path).unlink(), "model card .* is missing"),
        (lambda path: card_path(path).write_text("{"), "cannot be read"),
        (lambda path: card_path(path).write_text("[1]"), "cannot be read"),
        (lambda path: card_path(path).write_text("{}"), "cannot be read"),
        (lambda path: path.write_bytes(path.read_bytes()[:-1]), "sha256 differs"),
        (other_weights, "sha256 differs"),
        (vpn_instead, "holds a vpn network, wanted is vpt-tob"),
        (lambda path: change_card(path, network={"width": 0.5}), "do not fit"),
        (lambda path: change_card(path, network={"depth": 3}), "do not fit"),
    ],
)
def test_unusable_weights_are_refused_in_one_line(weights: Path, spoil: Callable[[Path], object], says: str) -> None:
    spoil(weights)
    with pytest.raises(UnusableWeights, match=says) as caught:
        load(weights, VptTob)
    assert "\n" not in str(caught.value)


def test_damaged_tensors_under_a_matching_card_are_refused(weights: Path) -> None:
    import hashlib

    weights.write_bytes(b"\xff" * 64)
    change_card(weights, sha256=hashlib.sha256(weights.read_bytes()).hexdigest())
    with pytest.raises(UnusableWeights, match="do not fit"):
        load(weights, VptTob)


@pytest.mark.parametrize("name", ["vpt-tob", "vpn"])
def test_the_released_weights_load(name: str) -> None:
    network, card = load_any(Path(__file__).parents[2] / "weights" / f"{name}.safetensors")
    assert network.architecture == card.architecture == name


def test_every_architecture_comes_back_and_none_is_taken_for_another(tmp_path: Path) -> None:
    for name, (make, settings) in ARCHITECTURES.items():
        network = make(settings())
        assert network.architecture == name
        save(network, tmp_path / f"{name}.safetensors", card_of(network))
        again, card = load_any(tmp_path / f"{name}.safetensors")
        assert type(again) is make and again.settings == network.settings and card.architecture == name
    with pytest.raises(UnusableWeights, match="holds a self-perspective network, wanted is vpt-tob"):
        load(tmp_path / "self-perspective.safetensors", VptTob)
    with pytest.raises(UnusableWeights, match="holds a vpt-tob network, wanted is self-perspective"):
        load(tmp_path / "vpt-tob.safetensors", SelfPerspective)
