"""Weights by name, from a server on this machine that speaks the hub's protocol."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from safetensors import safe_open

from remind_jax.backbone import get_backbone
from remind_jax.backbone.published_weights import PUBLISHED
from remind_jax.backbone.vit_variants import VARIANTS
from remind_jax.backbone.vit_weights import load_weights
from remind_jax.backbone.weights_download import obtain_weights, place_of_original
from remind_jax.errors import OutputError, WeightsError
from tests.backbone.hub_networks import (
    FILE,
    NAME,
    PLAIN,
    REPOSITORY,
    REVISION,
    published_network,
)

CONVERTED = [f"{NAME}.safetensors"]


@pytest.fixture
def published(tmp_path, monkeypatch):
    with published_network(tmp_path, monkeypatch) as it:
        yield it


def told(**options) -> str:
    """The sentence of the error that ends fetching."""
    with pytest.raises((WeightsError, OutputError)) as caught:
        obtain_weights(NAME, quiet=True, **options)
    sentence = str(caught.value)
    assert "\n" not in sentence
    return sentence


class TestFetching:
    def test_a_name_is_enough(self, published):
        image = np.random.default_rng(0).integers(0, 256, (1, 70, 84, 3), np.uint8)
        features = get_backbone(NAME).extract(image)
        assert features.shape == (1, 5, 6, 64)
        assert published.kept == CONVERTED
        assert load_weights(published.cache / CONVERTED[0], NAME).variant.position == "offset"

    def test_the_file_says_where_it_comes_from(self, published):
        with safe_open(obtain_weights(NAME), framework="np") as file:
            said = file.metadata()
        assert said["source"] == f"{REPOSITORY}/{FILE} at {REVISION}"
        assert said["source_sha256"] == PUBLISHED[NAME].sha256
        assert said["licence"] == "Apache-2.0"

    def test_a_converted_file_that_was_damaged_can_be_had_again(self, published):
        path = obtain_weights(NAME)
        path.write_bytes(path.read_bytes()[:-8])
        with pytest.raises(WeightsError, match="or remove it, and it is fetched again"):
            get_backbone(NAME)

    def test_given_weights_are_never_replaced(self, published, tmp_path):
        assert "no weights" in told(given=tmp_path / "mistyped.safetensors")
        assert published.hub.requests == []

    def test_a_file_of_an_authors_server(self, published):
        published.publish_plain()
        assert load_weights(obtain_weights(NAME), NAME)
        assert published.hub.requests == [("GET", f"/{PLAIN}", "", False)]

    def test_without_a_known_hash_the_architecture_is_checked_and_the_hash_recorded(
        self, published
    ):
        published.publish_plain(sha256=None, num_bytes=None)
        with safe_open(obtain_weights(NAME), framework="np") as file:
            assert len(file.metadata()["source_sha256"]) == 64
        (published.cache / CONVERTED[0]).unlink()
        published.hub.files[PLAIN] = b"something else"
        assert "is not the network 'dinov2-test'" in told()
        assert published.kept == []


class TestHub:
    def test_what_the_hubs_cache_holds_is_used_and_left(self, published, tmp_path):
        folder = tmp_path / "hf" / "hub" / "models--facebook--test" / "snapshots" / REVISION
        folder.mkdir(parents=True)
        (folder / FILE).write_bytes(published.content)
        obtain_weights(NAME)
        assert published.hub.requests == []
        assert (folder / FILE).read_bytes() == published.content
        assert published.kept == CONVERTED

    def test_another_file_in_the_hubs_cache_is_not_used(self, published, tmp_path):
        folder = tmp_path / "hf" / "hub" / "models--facebook--test" / "snapshots" / REVISION
        folder.mkdir(parents=True)
        (folder / FILE).write_bytes(b"swapped")
        obtain_weights(NAME)
        assert published.kept == CONVERTED
        assert len(published.hub.requests) > 0

    def test_gated_without_access(self, published, monkeypatch):
        published.publish(is_gated=True)
        behavior = published.hub.behavior
        behavior.token, behavior.is_gated = "hf_right", True
        for token in (None, "hf_stale"):
            if token:
                monkeypatch.setenv("HF_TOKEN", token)
            sentence = told()
            assert f"ask for access at https://huggingface.co/{REPOSITORY}" in sentence
            assert "HF_TOKEN" in sentence
            assert published.kept == []

    @pytest.mark.parametrize(
        "trouble",
        [{"missing": "RepoNotFound"}, {"missing": "EntryNotFound"}, {"token": "x"}],
    )
    def test_not_there(self, published, trouble):
        for name, value in trouble.items():
            setattr(published.hub.behavior, name, value)
        assert f"{REPOSITORY}/{FILE} at {REVISION} cannot be fetched (" in told()
        assert published.kept == []

    def test_wrong_content(self, published):
        swapped = bytearray(published.content)
        swapped[-1] ^= 1
        published.hub.files[f"{REPOSITORY}/{FILE}"] = bytes(swapped)
        sentence = told()
        assert "is not the published file of" in sentence
        assert str(PUBLISHED[NAME].sha256) in sentence
        assert published.kept == []


class TestInterruptions:
    def test_a_connection_that_is_cut(self, published):
        published.hub.behavior.cuts_after = 300_000
        assert "cannot be fetched (" in told()
        assert published.kept == []
        published.hub.behavior.cuts_after = None
        obtain_weights(NAME)
        assert published.kept == CONVERTED

    def test_offline(self, published, monkeypatch):
        from huggingface_hub import constants

        monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
        sentence = told()
        assert "cannot be fetched (" in sentence
        assert f"to '{place_of_original(NAME)}'" in sentence
        assert published.hub.requests == []

    def test_a_file_brought_by_hand(self, published, monkeypatch):
        from huggingface_hub import constants

        monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
        place = place_of_original(NAME)
        place.parent.mkdir(parents=True)
        place.write_bytes(published.content[:-1])
        assert "is not the published file" in told()
        place.write_bytes(published.content)
        obtain_weights(NAME)
        assert published.kept == CONVERTED


# A fresh process, which knows the made network and reads the environment as users set it.
SCRIPT = """
import json, sys
from remind_jax.backbone.published_weights import PUBLISHED, PublishedWeights
from remind_jax.backbone.vit_variants import VARIANTS, Variant
from remind_jax.backbone.weights_download import obtain_weights
from remind_jax.errors import RemindError
name, variant, entry = json.loads(sys.argv[1])
VARIANTS[name], PUBLISHED[name] = Variant(**variant), PublishedWeights(**entry)
try:
    print(obtain_weights(name))
except RemindError as error:
    sys.exit(str(error))
"""


@pytest.fixture
def process(published, tmp_path):
    """Starts processes that want the weights."""
    told = [NAME, *(dataclasses.asdict(table[NAME]) for table in (VARIANTS, PUBLISHED))]
    known = {k: v for k, v in os.environ.items() if not k.startswith(("HF_", "REMIND_"))}
    started = []

    def start(**environment: str) -> subprocess.Popen[str]:
        new = subprocess.Popen(
            [sys.executable, "-c", SCRIPT, json.dumps(told)],
            env={**known, "XDG_CACHE_HOME": str(tmp_path), "HF_HOME": str(tmp_path / "home")}
            | {"HF_ENDPOINT": published.hub.address, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(new)
        return new

    yield start
    for one in started:
        one.kill()
        one.communicate()


def kept_in(tmp_path) -> list[str]:
    folder = tmp_path / "remind-jax" / "weights"
    found = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".lock")
    return sorted(str(path.relative_to(folder)) for path in found)


class TestProcesses:
    def test_the_environment_is_read(self, process, published, tmp_path):
        out, err = process(HF_HUB_OFFLINE="1").communicate()
        assert (out, published.hub.requests) == ("", [])
        assert "cannot be fetched (" in err
        published.hub.behavior.token = "hf_right"
        (tmp_path / "home").mkdir(exist_ok=True)
        (tmp_path / "home" / "token").write_text("hf_right")  # as `hf auth login` leaves it
        out, err = process().communicate()
        assert out.strip() == str(tmp_path / "remind-jax" / "weights" / CONVERTED[0])
        assert err.count("\n") == 1
        assert kept_in(tmp_path) == CONVERTED

    def test_two_at_once_fetch_once(self, process, published, tmp_path):
        published.hub.behavior.delay_s = 0.1
        both = process(), process()
        outcomes = [one.communicate() for one in both]
        assert len({out for out, _ in outcomes}) == 1
        assert sum("fetching" in err for _, err in outcomes) == 1
        assert len([path for path, _ in published.hub.bodies if "/cdn/" in path]) == 1
        assert kept_in(tmp_path) == CONVERTED
