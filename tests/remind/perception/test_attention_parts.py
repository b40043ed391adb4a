"""Parts by attention in the tracker: what it asks of its backbone, and when."""

import dataclasses
import functools

import jax
import numpy as np
import pytest

from remind_jax.backbone import get_backbone
from remind_jax.config import load_config
from remind_jax.errors import ConfigError
from remind_jax.remind.method import METHOD
from remind_jax.remind.tracker import init
from remind_jax.session import frame_features
from remind_jax.session.growing_memory import GrowingMemory
from remind_jax.session.live import Tracker
from tests.backbone.networks import converted_file

STATIC = {"num_detections": 4, "num_objects": 6, "num_pending": 4}
SIZE = (64, 96)


def remind(static):
    return {"base": "remind", "static": static}


class Stopped(Exception):
    """The step was reached."""


@pytest.fixture(scope="module")
def backbone():
    """A tiny transformer with random weights, and a note of what it was asked for."""
    made = get_backbone(f"vit:{converted_file('dinov3_tiny_mlp')}")
    asked = []

    def attend(images, patches, heads=None):
        asked.append((np.asarray(patches)[0], heads))
        return made.check_attention()(images, patches, heads=heads)

    return dataclasses.replace(made, apply_with_attention=attend), asked


@pytest.fixture
def frame():
    rng = np.random.default_rng(0)
    masks = np.zeros((2, *SIZE), bool)
    masks[0, 5:40, 8:50] = True
    masks[1, 30:60, 60:90] = True
    return rng.integers(0, 256, (*SIZE, 3), np.uint8), masks


@pytest.fixture
def reached(monkeypatch):
    """Frames as they reach the step, which is not run."""
    taken = []

    def look(self, frame_feats, prepared, thresholds):
        taken.append((frame_feats, prepared.masks))
        raise Stopped

    monkeypatch.setattr(GrowingMemory, "step", look)
    return taken


@pytest.mark.heavy
def test_the_step_gets_the_attention_between_object_patches(backbone, frame, reached):
    eyes, asked = backbone
    image, masks = frame
    heads = (1, 0)
    tracker = Tracker(remind({**STATIC, "part_source": "both", "attention_heads": heads}), eyes)
    with pytest.raises(Stopped):
        tracker.update(image, masks)
    feats, reduced = reached[0]
    patches, given_heads = asked[-1]
    assert given_heads == heads
    px = eyes.patch_px
    tiles = masks.any(axis=0).reshape(SIZE[0] // px, px, SIZE[1] // px, px).any(axis=(1, 3))
    np.testing.assert_array_equal(patches[patches >= 0], np.flatnonzero(tiles))
    np.testing.assert_array_equal(feats.attention.patches, patches)
    features, paid = eyes.extract_with_attention(image[None], patches[None], heads)
    np.testing.assert_array_equal(feats.patches, features[0])
    np.testing.assert_array_equal(feats.attention.block, paid.block[0])
    np.testing.assert_array_equal(feats.attention.row_sums, paid.row_sums[0])

    static = dataclasses.replace(
        tracker.static, feature_dim=eyes.dim, num_detections=len(reduced.valid)
    )
    run = functools.partial(METHOD.step, static=static, thresholds=tracker.config.thresholds)
    state = init(static)
    after = jax.eval_shape(run, state, feats, reduced)
    assert after.parts.size.shape[1] == 2
    assert jax.tree.map(np.shape, after) == jax.tree.map(np.shape, state)


def test_slots_double_with_the_objects(backbone, frame, reached, monkeypatch):
    eyes, asked = backbone
    image, masks = frame
    monkeypatch.setattr(frame_features, "_FIRST_SLOTS", 2)
    tracker = Tracker(remind({**STATIC, "part_source": "attention"}), eyes)
    for shown in (masks, masks[1:]):
        with pytest.raises(Stopped):
            tracker.update(image, shown)
    first, second = (patches for patches, _ in asked[-2:])
    assert len(first) == len(second) < 2 * (first >= 0).sum()
    assert (second >= 0).sum() < (first >= 0).sum()


def test_nothing_is_asked_unless_wanted(backbone, frame, reached):
    eyes, asked = backbone
    before = len(asked)
    with pytest.raises(Stopped):
        Tracker(remind(STATIC), eyes).update(*frame)
    assert len(asked) == before
    assert reached[0][0].attention is None


def test_a_backbone_without_attention_is_refused_at_once():
    with pytest.raises(ConfigError, match="'patch-statistics' has no attention"):
        Tracker(remind({"part_source": "attention"}), "patch-statistics")


@pytest.mark.slow
def test_both_kinds_of_parts_are_remembered(backbone, frame):
    config = load_config("remind").updated(
        {
            "static": {**STATIC, "part_source": "both"},
            "thresholds": {
                "perception": {"part_min_patches": 1},
                "appearance": {"patches_min": 0.0, "patches_full": 1.0},
                "similarity": {"object_min_patches": 1.0, "object_full_patches": 2.0},
            },
        }
    )
    tracker = Tracker(config, backbone[0])
    for _ in range(3):
        tracks = tracker.update(*frame)
    assert tracks.object_id.tolist() == [0, 1]
    assert (np.asarray(tracker.state.parts.work.size)[:, :2] > 0).all()
