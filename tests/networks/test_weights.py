"""Weights are used only with the card that describes them; whatever else lies there is refused with a readable line."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

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


def test_weights_with_numbers_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    for value in (float("nan"), float("inf")):
        network, path = VptTob(SMALL), tmp_path / "vpt-tob.safetensors"
        with torch.no_grad():
            network.view.bias[0] = value  # type: ignore[index]
        save(network, path, card_of(network))
        for loader in (load_any, lambda path: load(path, VptTob)):
            with pytest.raises(UnusableWeights, match=r"hold numbers that are not finite, in `view.bias`: train again"):
                loader(path)


DEEP = "[" * 100_000 + "]" * 100_000


@pytest.mark.parametrize(
    ("card", "says"),
    [
        ('{"architecture": "vpn", "network": "text"}', "cannot be read"),
        ('{"architecture": ["vpn"], "network": {}}', "cannot be read"),
        ('{"architecture": "vpn", "network": {}, "notes": [1]}', "cannot be read"),
        ('{"architecture": "vpn", "network": {}, "inputs": {"a": ["b"]}}', "cannot be read"),
        (f'{{"architecture": "vpn", "network": {{"width": {DEEP}}}}}', "nested too deep"),
        ('{"architecture": "vpn", "network": {}, "version": ' + "1" * 5000 + "}", "cannot be read"),
        ('{"architecture": "\\u001b[31mvpn\\u001b[0m", "network": {}}', r"holds a \[31mvpn\[0m network"),
        ("\udcff", "cannot be read"),
    ],
)
def test_cards_that_are_no_cards_are_refused_in_one_line(weights: Path, card: str, says: str) -> None:
    card_path(weights).write_bytes(card.encode(errors="surrogateescape"))
    with pytest.raises(UnusableWeights, match=says) as caught:
        load_any(weights)
    assert "\n" not in str(caught.value) and "\x1b" not in str(caught.value) and len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    ("architecture", "network"),
    [
        ("vpt-tob", {"width": 1e300}),
        ("vpt-tob", {"width": 4000.0}),
        ("vpt-tob", {"encoder": [4] * 7}),
        ("vpt-tob", {"encoder": [[4]] * 8}),
        ("vpt-tob", {"width": "wide"}),
        ("vpt-tob", {"caught_head": "yes"}),
        ("vpn", {"dropout": 7.5}),
        ("vpn", {"width": 10**12}),
        ("hazard-attention", {"heads": 0}),
        ("hazard-attention", {"heads": 7}),
        ("coordinate-value", {"variant": "middle"}),
    ],
)
def test_settings_of_no_network_are_refused_before_memory_is_taken_for_it(
    weights: Path, architecture: str, network: dict[str, object]
) -> None:
    change_card(weights, architecture=architecture, network=network)
    with pytest.raises(UnusableWeights, match="do not fit the network of their card") as caught:
        load_any(weights)
    assert "\n" not in str(caught.value)


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
_SETTINGS = ("encoder", "decoder", "width", "whole_image", "caught_head", "hidden", "dropout", "heads", "layers", "variant")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_a_card_holds_the_weights_load_or_are_refused_in_one_line(weights: Path, data: st.DataObject) -> None:
    whole = json.loads(card_path(weights).read_text())
    changed = data.draw(st.dictionaries(st.sampled_from(sorted(whole)), _JSON, max_size=3), "card")
    network = data.draw(st.none() | st.dictionaries(st.sampled_from(_SETTINGS), _JSON, max_size=3), "network")
    card = {**whole, "architecture": data.draw(st.sampled_from(sorted(ARCHITECTURES)), "architecture"), **changed}
    if network is not None:
        card["network"] = network
    spoilt = weights.with_name("spoilt.safetensors")
    spoilt.write_bytes(weights.read_bytes())
    card_path(spoilt).write_text(json.dumps(card))
    refusal = ""
    try:
        load_any(spoilt)
    except UnusableWeights as error:
        refusal = str(error)
    assert "\n" not in refusal


def test_a_full_disk_leaves_the_pair_before_it(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {path.name: path.read_bytes() for path in weights.parent.iterdir()}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    for name in ("fsync", "open"):
        with monkeypatch.context() as broken:
            broken.setattr(os, name, full)
            with pytest.raises(OSError, match="No space left on device"):
                save(VptTob(SMALL), weights, card_of(VptTob(SMALL)))
        assert {path.name: path.read_bytes() for path in weights.parent.iterdir()} == before
    load(weights, VptTob)


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
    for name, (make, shape) in ARCHITECTURES.items():
        network = make(shape())
        assert network.architecture == name
        save(network, tmp_path / f"{name}.safetensors", card_of(network))
        again, card = load_any(tmp_path / f"{name}.safetensors")
        assert type(again) is make and again.settings == network.settings and card.architecture == name
    with pytest.raises(UnusableWeights, match="holds a self-perspective network, wanted is vpt-tob"):
        load(tmp_path / "self-perspective.safetensors", VptTob)
    with pytest.raises(UnusableWeights, match="holds a vpt-tob network, wanted is self-perspective"):
        load(tmp_path / "vpt-tob.safetensors", SelfPerspective)
