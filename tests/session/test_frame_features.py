"""Features of the patches that a method reads, and of no others."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.backbone import Backbone
from remind_jax.frame import Detections, Frame
from remind_jax.method import get_method, list_methods
from remind_jax.session.frame_features import FrameFeatures
from remind_jax.session.live import Tracker

PATCH_PX, HEIGHT, WIDTH = 8, 96, 128
GARBAGE = 77.0
METHODS = [name for name in list_methods() if get_method(name).patch_reach is not None]


def describe(images: np.ndarray) -> np.ndarray:
    """Means of each patch and of its upper half, and a product of both."""
    num, height, width = images.shape[:3]
    shape = (num, height // PATCH_PX, PATCH_PX, width // PATCH_PX, PATCH_PX, 3)
    patches = np.asarray(images, np.float32).reshape(shape) / 255
    whole, upper = patches.mean((2, 4)), patches[:, :, : PATCH_PX // 2].mean((2, 4))
    return np.concatenate([whole, upper, whole * upper[..., ::-1]], axis=-1)


class Recorder:
    """A backbone that says what it was asked for; what nobody wants is garbage."""

    def __init__(self) -> None:
        self.wanted: list[np.ndarray | None] = []
        self.whole = Backbone("means", PATCH_PX, 9, self.apply)
        self.in_part = Backbone("means", PATCH_PX, 9, self.apply, apply_to=self.apply_to)

    def apply(self, images):
        self.wanted.append(None)
        return jax.numpy.asarray(describe(images))

    def apply_to(self, images, wanted):
        self.wanted.append(wanted)
        return jax.numpy.asarray(np.where(wanted[..., None], describe(images), GARBAGE))


def frames(num: int):
    """Three squares that move over grain; in the third frame there is none."""
    rng = np.random.default_rng(0)
    scene = rng.integers(60, 160, (HEIGHT, WIDTH, 3), np.uint8)
    for frame in range(num):
        image, masks = scene.copy(), np.zeros((0 if frame == 2 else 3, HEIGHT, WIDTH), bool)
        for index in range(len(masks)):
            top, left = 4 + 20 * index, (10 + 40 * index + 3 * frame) % (WIDTH - 20)
            masks[index, top : top + 18, left : left + 20] = True
            image[masks[index]] = (220, 40, 40 + 70 * index)
        yield image, masks


@pytest.mark.parametrize("name", METHODS)
def test_no_method_reads_features_beyond_its_reach(name):
    whole, part = Recorder(), Recorder()
    static = {"num_detections": 4, "num_objects": 8, "num_pending": 4}
    one = Tracker({"static": static}, whole.whole, tracker=name)
    other = Tracker({"static": static}, part.in_part, tracker=name)
    for image, masks in frames(6):
        one.update(image, masks)
        other.update(image, masks)
        jax.tree.map(np.testing.assert_array_equal, one.state, other.state)
    assert int(one.state.frame) == 6
    assert not any(wanted is None or np.all(wanted) for wanted in part.wanted)


def test_plus_asks_for_objects_and_what_is_around_them():
    recorder = Recorder()
    tracker = Tracker(backbone=recorder.in_part)
    mask = np.zeros((1, HEIGHT, WIDTH), bool)
    mask[0, 40, 63:65] = True  # one pixel of each of two patches
    tracker.update(np.zeros((HEIGHT, WIDTH, 3), np.uint8), mask)
    expected = np.zeros((1, HEIGHT // PATCH_PX, WIDTH // PATCH_PX), bool)
    expected[0, 3:8, 5:11] = True
    np.testing.assert_array_equal(recorder.wanted[0], expected)


def test_a_method_that_reads_all_gets_all():
    recorder, (image, masks) = Recorder(), next(frames(1))
    tracker = Tracker(backbone=recorder.in_part, tracker="bank")
    method = dataclasses.replace(tracker.method, patch_reach=None)
    prepared = tracker.prepare(
        Frame(0, 0, 0.0, "one", image, Detections.create(masks, ["box"] * 3))
    )
    seen = FrameFeatures(method, recorder.in_part).describe(prepared, tracker.static)
    assert recorder.wanted == [None]
    np.testing.assert_array_equal(seen.patches, describe(image[None])[0])
