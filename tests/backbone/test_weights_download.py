"""Weights by name, from what stands for the hub."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from safetensors import safe_open

from remind_jax.backbone import get_backbone
from remind_jax.backbone.published_weights import PUBLISHED
from remind_jax.backbone.vit_weights import load_weights
from remind_jax.backbone.weights_download import obtain_weights, place_of_original
from remind_jax.errors import OutputError, WeightsError
from tests.backbone.hub_networks import FILE, NAME, PLAIN, REPOSITORY, REVISION, published_network

CONVERTED = [f"{NAME}.safetensors"]
ADDRESS = f"{REPOSITORY}/{REVISION}/{FILE}"


@pytest.fixture
def published(tmp_path, monkeypatch):
    return published_network(tmp_path, monkeypatch)


def told(**options) -> str:
    """The sentence of the error that ends fetching."""
    with pytest.raises((WeightsError, OutputError)) as caught:
        obtain_weights(NAME, quiet=True, **options)
    return str(caught.value)


def test_a_name_is_enough(published):
    image = np.random.default_rng(0).integers(0, 256, (1, 70, 84, 3), np.uint8)
    features = get_backbone(NAME).extract(image)
    assert features.shape == (1, 5, 6, 64)
    assert published.kept == CONVERTED
    assert load_weights(published.cache / CONVERTED[0], NAME).variant.position == "offset"
    with safe_open(obtain_weights(NAME), framework="np") as file:
        said = file.metadata()
    assert said["source"] == f"{REPOSITORY}/{FILE} at {REVISION}"
    assert said["source_sha256"] == PUBLISHED[NAME].sha256
    assert said["licence"] == "Apache-2.0"
    assert published.hub.fetched == [ADDRESS]


def test_a_converted_file_that_was_damaged_can_be_had_again(published):
    path = obtain_weights(NAME)
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(WeightsError, match="or remove it, and it is fetched again"):
        get_backbone(NAME)


def test_given_weights_are_never_replaced(published, tmp_path):
    assert "no weights" in told(given=tmp_path / "mistyped.safetensors")
    assert published.hub.fetched == []


def test_a_file_of_an_authors_server(published):
    published.publish_plain()
    assert load_weights(obtain_weights(NAME), NAME)
    assert published.hub.fetched == [PLAIN]


def test_without_a_known_hash_the_architecture_is_checked_and_the_hash_recorded(published):
    published.publish_plain(sha256=None, num_bytes=None)
    with safe_open(obtain_weights(NAME), framework="np") as file:
        assert len(file.metadata()["source_sha256"]) == 64
    (published.cache / CONVERTED[0]).unlink()
    published.hub.files[PLAIN] = b"something else"
    assert "is not the network 'dinov2-test'" in told()
    assert published.kept == []


@pytest.mark.parametrize("is_swapped", [False, True])
def test_what_the_hubs_cache_holds_is_used_if_it_is_right(published, tmp_path, is_swapped):
    folder = tmp_path / "hf" / "hub" / "models--facebook--test" / "snapshots" / REVISION
    folder.mkdir(parents=True)
    content = b"swapped" if is_swapped else published.content
    (folder / FILE).write_bytes(content)
    obtain_weights(NAME)
    assert published.hub.fetched == [ADDRESS] * is_swapped
    assert (folder / FILE).read_bytes() == content
    assert published.kept == CONVERTED


@pytest.mark.parametrize("is_gated", [False, True])
def test_what_cannot_be_fetched_may_be_brought_by_hand(published, is_gated):
    published.publish(is_gated=is_gated)
    published.hub.error = OSError("no such host")
    sentence, place = told(), place_of_original(NAME)
    assert f"{REPOSITORY}/{FILE} at {REVISION} cannot be fetched (no such host)" in sentence
    assert f"to '{place}'" in sentence
    assert (f"ask for access at https://huggingface.co/{REPOSITORY}" in sentence) == is_gated
    assert published.kept == []
    place.parent.mkdir(parents=True)
    place.write_bytes(published.content[:-1])
    assert "is not the published file" in told()
    place.write_bytes(published.content)
    obtain_weights(NAME)
    assert published.kept == CONVERTED


def test_wrong_content(published):
    published.hub.files[ADDRESS] = published.content[:-1] + b"x"
    sentence = told()
    assert "is not the published file of" in sentence
    assert str(PUBLISHED[NAME].sha256) in sentence
    assert published.kept == []


def test_two_at_once_fetch_once(published):
    published.hub.delay_s = 0.5
    with ThreadPoolExecutor(2) as pool:
        assert len(set(pool.map(obtain_weights, [NAME, NAME]))) == 1
    assert published.hub.fetched == [ADDRESS]
