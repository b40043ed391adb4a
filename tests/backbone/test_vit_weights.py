"""Converted files: found where they should be, and refused if anything about them is wrong."""

import json
import re
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from remind_jax.backbone import vit_weights
from remind_jax.backbone.vit_variants import VARIANTS
from remind_jax.backbone.vit_weights import WEIGHTS_VARIABLE, find_weights, load_weights
from remind_jax.errors import WeightsError
from tests.backbone.networks import converted_file
from tests.weights_convert.pth_files import write_pth


def read(path) -> tuple[dict, bytes]:
    data = path.read_bytes()
    length = struct.unpack("<Q", data[:8])[0]
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def write(path, header: dict, data: bytes):
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data)
    return path


@pytest.fixture
def spoilt(tmp_path):
    """Changes header or bytes of a sound file; returns what the loader says."""

    def spoil(change=lambda header: None, data=lambda data: data) -> str:
        header, content = read(converted_file("dino_tiny"))
        change(header)
        path = write(tmp_path / "spoilt.safetensors", header, data(content))
        with pytest.raises(WeightsError) as caught:
            load_weights(path)
        return str(caught.value)

    return spoil


def test_leaf_missing_or_left_over_or_of_another_shape(spoilt):
    def rename(header):
        header["norm.extra"] = header.pop("norm.bias")
        header["cls_token"]["shape"] = [64, 1]

    message = spoilt(rename)
    assert "missing: norm.bias" in message
    assert "left over: norm.extra" in message
    assert "of another shape: cls_token" in message


def test_bytes_that_changed_or_are_missing(spoilt):
    def flip(data):
        return data[:999] + bytes([data[999] ^ 1]) + data[1000:]

    assert "are not those that were written: the sha256" in spoilt(data=flip)
    assert "is damaged or of another form" in spoilt(data=lambda data: data[:-4])


def test_a_checkpoint_that_was_not_converted_says_what_to_do(tmp_path):
    path = tmp_path / "dinov2_vits14_pretrain.pth"
    write_pth(path, {"cls_token": np.zeros((1, 1, 8), np.float32)})
    with pytest.raises(WeightsError, match=f"remind convert '{path}'"):
        load_weights(path)


def describe(**values):
    def change(header):
        meta = header["__metadata__"]
        meta["architecture"] = json.dumps(json.loads(meta["architecture"]) | values)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda h: h.pop("__metadata__"), "was not written by remind-jax"),
        (lambda h: h["__metadata__"].update(schema="2"), "has schema 2, this version reads 1"),
        (lambda h: h["__metadata__"].update(dtype="int4"), "header of .* is damaged"),
        (lambda h: h["__metadata__"].pop("dtype"), "header of .* is damaged"),
        (lambda h: h["__metadata__"].update(architecture="{"), "header of .* is damaged"),
        (lambda h: h["__metadata__"].update(architecture="[]"), "header of .* is damaged"),
        (describe(heads=0), "header of .* is damaged"),
        (describe(heads="two"), "header of .* is damaged"),
        (describe(heads=3), "header of .* is damaged"),
        (describe(family="clip"), "header of .* is damaged"),
        (describe(depth=1 << 20), "header of .* is damaged.*depth"),
        (describe(norm_eps=float("nan")), "header of .* is damaged"),
        (describe(width=2.0), "header of .* is damaged.*width"),
        (lambda h: h["__metadata__"].update(architecture="[" * 9999), "header of .* is damaged"),
        (describe(depth=4), "missing: blocks.3"),
        (describe(name="dinov3-vits16"), "calls itself 'dinov3-vits16' but describes 'custom'"),
    ],
)
def test_headers_are_not_believed(spoilt, change, message):
    assert re.search(message, spoilt(change))


@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(position=st.integers(0, 8000), value=st.integers(0, 255))
def test_any_changed_byte_of_the_header_is_refused_or_harmless(tmp_path, position, value):
    data = bytearray(converted_file("dino_tiny").read_bytes())
    data[position] = value
    path = tmp_path / "changed.safetensors"
    path.write_bytes(data)
    try:
        found = load_weights(path)
    except WeightsError:
        return
    expected = load_weights(converted_file("dino_tiny"))
    assert found.sha256 == expected.sha256
    assert found.params.keys() == expected.params.keys()


class TestFinding:
    @pytest.fixture(autouse=True)
    def cache(self, monkeypatch, tmp_path):
        monkeypatch.delenv(WEIGHTS_VARIABLE, raising=False)
        monkeypatch.setattr(vit_weights, "user_cache_folder", lambda: tmp_path / "cache")
        (tmp_path / "cache" / "weights").mkdir(parents=True)
        return tmp_path / "cache" / "weights"

    def test_given_file_and_folder(self, tmp_path):
        file = tmp_path / "dinov3-vits16.safetensors"
        file.write_text("")
        assert find_weights("dinov3-vits16", file) == file
        assert find_weights("dinov3-vits16", tmp_path) == file

    def test_environment_variable_then_cache(self, tmp_path, cache, monkeypatch):
        in_cache = cache / "dino-vits8.safetensors"
        in_cache.write_text("")
        assert find_weights("dino-vits8", None) == in_cache
        named = tmp_path / "mine.safetensors"
        named.write_text("")
        monkeypatch.setenv(WEIGHTS_VARIABLE, str(named))
        assert find_weights("dino-vits8", None) == named
        monkeypatch.setenv(WEIGHTS_VARIABLE, str(tmp_path / "nowhere"))
        assert find_weights("dino-vits8", None) == in_cache

    def test_a_wrong_path_is_not_replaced_by_another_file(self, tmp_path, cache):
        (cache / "dino-vits8.safetensors").write_text("")
        with pytest.raises(WeightsError, match="mistyped"):
            find_weights("dino-vits8", tmp_path / "mistyped.safetensors")

    @pytest.mark.parametrize("name", VARIANTS)
    def test_absent_weights_say_where_to_get_them_and_under_which_license(self, name):
        with pytest.raises(WeightsError) as caught:
            find_weights(name, None)
        message = str(caught.value)
        assert ("DINOv3 License" if name.startswith("dinov3") else "Apache-2.0") in message
        assert "https://" in message
        assert "remind convert" in message
        assert WEIGHTS_VARIABLE in message
