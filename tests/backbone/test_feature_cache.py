"""Features on disk: found again by exactly what they depend on, whole or not at all."""

import dataclasses
import os

import numpy as np
import pytest

from remind_jax.backbone.feature_cache import cache_features, place_of
from remind_jax.backbone.registry import Backbone
from remind_jax.errors import OutputError

IMAGES = np.random.default_rng(0).integers(0, 256, (3, 8, 12, 3), np.uint8)


class Counting:
    """Mean colors of 4x4 patches, and how many images they were computed for."""

    def __init__(self) -> None:
        self.num_images = 0
        self.backbone = Backbone("mean-color", 4, 3, self.apply, fingerprint="1")

    def apply(self, images):
        self.num_images += len(images)
        cells = np.asarray(images, np.float32).reshape(len(images), 2, 4, -1, 4, 3)
        return cells.mean(axis=(2, 4))


@pytest.fixture
def counting():
    return Counting()


def test_features_are_computed_once_and_only_where_they_are_missing(counting, tmp_path):
    cached, expected = cache_features(counting.backbone, tmp_path), Counting().apply(IMAGES)
    np.testing.assert_array_equal(cached.extract(IMAGES[1:2]), expected[1:2])
    for _ in range(2):
        np.testing.assert_array_equal(cached.extract(IMAGES), expected)
    again = cache_features(counting.backbone, tmp_path)
    np.testing.assert_array_equal(again.extract(IMAGES[1:]), expected[1:])
    assert counting.num_images == 3


def test_features_of_other_types_are_found_again_too(counting, tmp_path):
    half = dataclasses.replace(
        counting.backbone, apply=lambda images: counting.apply(images).astype(np.float16)
    )
    for _ in range(2):
        cache_features(half, tmp_path).extract(IMAGES)
    assert counting.num_images == 3


def test_everything_that_changes_features_changes_the_place(counting):
    backbone = counting.backbone
    image = IMAGES[0]
    changed = image.copy()
    changed[3, 3, 1] ^= 1
    places = {
        place_of(image, backbone),
        place_of(changed, backbone),
        place_of(image.reshape(12, 8, 3), backbone),  # the same bytes at another size
        place_of(image, dataclasses.replace(backbone, fingerprint="2")),
        place_of(image, dataclasses.replace(backbone, name="mean-colors")),
    }
    assert len(places) == 5


def test_damage_anywhere_is_found_and_features_are_made_again(counting, tmp_path):
    cached = cache_features(counting.backbone, tmp_path)
    expected = np.asarray(cached.extract(IMAGES[:1]))
    file = tmp_path / place_of(IMAGES[0], counting.backbone)
    whole = file.read_bytes()
    damaged = [b"", b"\x93NUMPY", b"rubbish", whole[:-5]]
    for place in range(0, len(whole) - 1, 7):
        flipped = bytearray(whole)
        flipped[place] ^= 0x10
        flipped[place + 1] ^= 1
        damaged.append(bytes(flipped))
    for number, content in enumerate(damaged, 2):
        file.write_bytes(content)
        np.testing.assert_array_equal(cached.extract(IMAGES[:1]), expected)
        assert counting.num_images == number
        assert file.read_bytes() == whole


@pytest.mark.parametrize("when", ["np.save", "os.replace"])
def test_an_interruption_leaves_no_half_file(counting, tmp_path, monkeypatch, when):
    cached = cache_features(counting.backbone, tmp_path)
    cached.extract(IMAGES[:1])

    def interrupt(*args):
        if when == "np.save":
            args[0].write(b"\x93NUMPY half")
        raise KeyboardInterrupt

    module, name = (np, "save") if when == "np.save" else (os, "replace")
    monkeypatch.setattr(module, name, interrupt)
    with pytest.raises(KeyboardInterrupt):
        cached.extract(IMAGES)
    monkeypatch.undo()
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert files == [tmp_path / place_of(IMAGES[0], counting.backbone)]
    np.testing.assert_array_equal(cached.extract(IMAGES), Counting().apply(IMAGES))


def test_a_folder_that_cannot_be_written_to(counting, tmp_path):
    cached = cache_features(counting.backbone, tmp_path)
    place = tmp_path / place_of(IMAGES[0], counting.backbone)
    place.parent.write_text("in the way")
    with pytest.raises(OutputError, match="cannot make the output folder"):
        cached.extract(IMAGES[:1])
