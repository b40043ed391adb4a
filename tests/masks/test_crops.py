"""Masks as boxes: all that is made of them equals what is made of planes."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax import crops as crops_module
from remind_jax.crops import Crops, cut_plane, cut_runs
from remind_jax.detectors import DetectorOptions, as_detector
from remind_jax.frame import Detections
from remind_jax.masks.alignment import Alignment
from remind_jax.masks.reduction import reduce_masks
from remind_jax.masks.run_length import decode_mask, encode_masks, read_runs
from remind_jax.session.answers import outline
from remind_jax.sources import label_maps
from remind_jax.sources.class_names import UNNAMED
from remind_jax.sources.detections import detections_from


def blobs(seed: int, num: int = 7, size: tuple[int, int] = (90, 130)) -> np.ndarray:
    """Masks of several pieces, touching, overlapping, at the border; one is empty."""
    rng = np.random.default_rng(seed)
    masks = np.zeros((num, *size), bool)
    for mask in masks[1:]:
        for _ in range(rng.integers(1, 4)):
            top, left = rng.integers(0, size[0]), rng.integers(0, size[1])
            height, width = rng.integers(1, 40, 2)
            mask[top : top + height, left : left + width] |= rng.random(
                mask[top : top + height, left : left + width].shape
            ) < rng.choice([0.3, 1.0])
    return masks


def crops_of(masks: np.ndarray) -> Crops:
    return Crops.of_planes(masks, (masks.shape[1], masks.shape[2]))


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_planes_come_back(seed):
    masks = blobs(seed)
    crops = crops_of(masks)
    assert crops.shape == masks.shape
    assert np.array_equal(np.asarray(crops), masks)
    assert all(np.array_equal(one, other) for one, other in zip(crops, masks, strict=True))
    assert np.array_equal(np.asarray(crops[np.array([3, 1])]), masks[[3, 1]])
    assert np.array_equal(np.asarray(crops[2:]), masks[2:])
    assert np.array_equal(crops[4], masks[4])
    for rows, columns in ((slice(0, 90), slice(0, 130)), (slice(20, 41), slice(60, 61))):
        for row in range(len(masks)):
            assert np.array_equal(crops.region(row, rows, columns), masks[row, rows, columns])


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_codes_and_outlines_are_the_same(seed):
    masks = blobs(seed)
    codes, expected = encode_masks(crops_of(masks)), encode_masks(masks)
    assert codes == expected
    assert np.array_equal(decode_mask(codes[1]), masks[1])
    ours, theirs = outline(crops_of(masks)), outline(masks)
    assert np.array_equal(ours.boxes, theirs.boxes)
    assert np.array_equal(ours.areas, theirs.areas)


OPTIONS = (
    {},
    {"sanitize": "morphology", "close_px": 5, "open_px": 3},
    {"keep_largest": True},
    {"erosion_px": 2},
    {"sanitize": "none"},
)


@pytest.mark.parametrize("options", OPTIONS)
@given(st.integers(0, 10_000))
@settings(max_examples=8, deadline=None)
def test_what_a_step_needs_is_the_same_to_the_last_bit(options, seed):
    masks = blobs(seed)
    rest = (np.arange(7, dtype=np.int32), np.ones(7, np.float32))
    made = [
        reduce_masks(which, *rest, num_slots=9, patch_px=16, **options)
        for which in (crops_of(masks), masks)
    ]
    for one, other in zip(*map(jax.tree.leaves, made), strict=True):
        assert np.array_equal(one, other)
    assert jax.tree.structure(made[0]) == jax.tree.structure(made[1])


@pytest.mark.parametrize("width", [64, 100, 130, 4000])
@pytest.mark.parametrize("center_crop", [False, True])
def test_alignment_is_the_same(width, center_crop):
    masks = blobs(3)
    alignment = Alignment.fit((90, 130), 16, max_width_px=width, center_crop=center_crop)
    aligned = alignment.align_masks(crops_of(masks))
    assert isinstance(aligned, Crops)
    assert np.array_equal(np.asarray(aligned), alignment.align_masks(masks))


def test_an_instance_map_is_taken_apart_alike(monkeypatch):
    labels = np.random.default_rng(0).integers(0, 60, (40, 50)) * 7 % 60
    planes = label_maps.detections_in(labels.astype(np.uint16), UNNAMED)
    monkeypatch.setattr(label_maps, "MOST_PLANES_BYTES", 0)
    for dtype in (np.uint8, np.uint16, np.int64):
        crops = label_maps.detections_in(labels.astype(dtype), UNNAMED)
        assert isinstance(crops.masks, Crops)
        assert np.array_equal(np.asarray(crops.masks), planes.masks)
        assert np.array_equal(crops.instance_ids, planes.instance_ids)
    given_map = detections_from(labels, (40, 50))
    assert isinstance(given_map.masks, Crops)
    smaller = detections_from(given_map, (80, 100))
    assert np.array_equal(np.asarray(smaller.masks), detections_from(planes, (80, 100)).masks)


def test_instances_all_over_the_picture_take_no_more_than_is_meant_for_them(monkeypatch):
    monkeypatch.setattr(label_maps, "MOST_PLANES_BYTES", 0)
    monkeypatch.setattr(crops_module, "MOST_MASK_BYTES", 50_000)
    labels = np.arange(100 * 100).reshape(100, 100) % 50
    with pytest.raises(label_maps.UnreadableFrame, match="49 detections in 100x100 pixels"):
        label_maps.detections_in(labels, UNNAMED)


@pytest.mark.parametrize("density", [0.0, 0.02, 0.5, 1.0])
@pytest.mark.parametrize("size", [(1, 1), (7, 3), (3, 7), (40, 50)])
def test_runs_are_cut_as_planes_are(density, size):
    rng = np.random.default_rng(size[0])
    for mask in rng.random((9, *size)) < density:
        (rle,) = encode_masks(mask[None])
        corner, window = cut_runs(read_runs(rle), size[0])
        expected_corner, expected = cut_plane(mask)
        assert corner == expected_corner
        assert window.dtype == bool
        assert np.array_equal(window, expected)


def test_detections_of_crops_are_chosen_and_checked():
    masks = blobs(1)
    seen = Detections.create(crops_of(masks), labels=list("abcdefg"))
    chosen = seen.select([2, 5])
    assert isinstance(chosen.masks, Crops)
    assert chosen.labels == ("c", "f")
    assert np.array_equal(np.asarray(chosen.masks), masks[[2, 5]])
    assert dataclasses.replace(seen, labels=seen.labels).masks is seen.masks


def test_a_detector_may_find_very_many(monkeypatch):
    monkeypatch.setattr(label_maps, "MOST_PLANES_BYTES", 0)
    labels = np.random.default_rng(0).integers(0, 9, (40, 50)).astype(np.uint8)
    options = DetectorOptions(min_mask_px=200, erosion_px=0)
    image = np.zeros((40, 50, 3), np.uint8)
    detector = as_detector(lambda image: labels, options)
    assert detector is not None
    found = detector(image)
    assert isinstance(found.masks, Crops)
    expected = [i for i in range(1, 9) if np.sum(labels == i) >= 200]
    assert found.instance_ids.tolist() == expected


def test_a_mask_beyond_the_last_whole_patch_is_empty():
    masks = np.zeros((2, 90, 130), bool)
    masks[0, 85:, 129:] = True
    masks[1, 70:, 100:] = True
    alignment = Alignment.fit((90, 130), 16, max_width_px=4000, center_crop=False)
    aligned = alignment.align_masks(crops_of(masks))
    assert np.array_equal(np.asarray(aligned), alignment.align_masks(masks))
    assert not np.asarray(aligned)[0].any()
    assert np.asarray(aligned)[1].any()
