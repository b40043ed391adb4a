"""A still scene keeps its identities, whatever its masks (method.md#first-view)."""

import functools

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from remind_jax.decision import NO_ID
from remind_jax.frame import Detections
from remind_jax.session.live import Tracker

HEIGHT_PX, WIDTH_PX, PATCH_PX = 64, 96, 16
NUM_FRAMES = 6
FEW = settings(
    max_examples=20,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.generate],  # a failing scene is shown as it is
    suppress_health_check=list(HealthCheck),
)


@functools.cache
def tracker_of(name: str) -> Tracker:
    # Masks may lie on each other here, and are no second ones of one thing.
    names = {"thresholds": {"names": {"cropped": 2.0}}} if name == "plus" else {}
    return Tracker({"input": {"double_overlap": 0.0}, **names}, tracker=name)


@st.composite
def rectangles(draw, most_px=WIDTH_PX):
    mask = np.zeros((HEIGHT_PX, WIDTH_PX), bool)
    top, left = draw(st.integers(0, HEIGHT_PX - 1)), draw(st.integers(0, WIDTH_PX - 1))
    height, width = draw(st.integers(1, most_px)), draw(st.integers(1, most_px))
    mask[top : top + height, left : left + width] = True
    return mask


@st.composite
def specks(draw):
    """Pixels all over the frame, so few that no patch is filled."""
    random = np.random.default_rng(draw(st.integers(0, 99)))
    mask = random.random((HEIGHT_PX, WIDTH_PX)) < draw(st.sampled_from([0.005, 0.05, 0.3]))
    mask[0, 0] = True
    return mask


@st.composite
def frames(draw):
    """The border of the frame: nothing is left around it."""
    mask = np.ones((HEIGHT_PX, WIDTH_PX), bool)
    width = draw(st.integers(1, 20))
    mask[width:-width, width:-width] = False
    return mask


masks = st.one_of(rectangles(), rectangles(most_px=1), specks(), frames())
several_masks = st.lists(masks, min_size=1, max_size=7).map(np.stack)
# Every patch looks different from every other.
textures = st.integers(0, 99).map(
    lambda seed: np.random.default_rng(seed).integers(0, 255, (HEIGHT_PX, WIDTH_PX, 3), np.uint8)
)
flat = arrays.arrays(np.uint8, 3).map(
    lambda color: np.broadcast_to(color, (HEIGHT_PX, WIDTH_PX, 3)).copy()
)


def watch(name: str, image: np.ndarray, masks: np.ndarray, labels: list[str]) -> np.ndarray:
    """Identities of every mask, frame by frame."""
    tracker = tracker_of(name)
    tracker.reset()
    seen = Detections.create(masks, labels)
    return np.stack([tracker.update(image, seen).object_id for _ in range(NUM_FRAMES)])


def patches_of(mask: np.ndarray) -> bytes:
    blocks = mask.reshape(HEIGHT_PX // PATCH_PX, PATCH_PX, WIDTH_PX // PATCH_PX, PATCH_PX)
    return blocks.any(axis=(1, 3)).tobytes()


@pytest.mark.parametrize(
    "name", ["plus", pytest.param("remind", marks=pytest.mark.slow), "bank", "running-mean", "iou"]
)
@FEW
@given(image=st.one_of(textures, flat), masks=several_masks, same_class=st.booleans())
def test_no_mask_gets_a_second_identity(name, image, masks, same_class):
    labels = ["thing"] * len(masks) if same_class else [str(row) for row in range(len(masks))]
    found = watch(name, image, masks, labels)
    assert set(found[0]) == set(range(len(masks)))
    assert set(found.ravel()) <= {NO_ID, *range(len(masks))}
    is_textured = np.ptp(image, axis=(0, 1)).any()
    looks_differ = is_textured and len({patches_of(mask) for mask in masks}) == len(masks)
    if looks_differ or not same_class:
        for ids in found.T:
            assert len(set(ids) - {NO_ID}) == 1


@FEW
@given(image=st.one_of(textures, flat), mask=masks)
def test_momentum_keeps_an_object_that_has_no_like(image, mask):
    """Among objects that look alike its softmax gives each a share too small for a match."""
    assert set(watch("momentum", image, mask[None], ["thing"]).ravel()) == {0}


@pytest.mark.slow
@FEW
@given(
    image=textures,
    top=st.integers(0, 4),
    left=st.integers(0, 4),
    bottom=st.integers(56, HEIGHT_PX),
    right=st.integers(88, WIDTH_PX),
)
def test_published_keeps_an_object_that_is_large_enough(image, top, left, bottom, right):
    """Smaller ones may found no prototype, as in the original."""
    mask = np.zeros((1, HEIGHT_PX, WIDTH_PX), bool)
    mask[0, top:bottom, left:right] = True
    tracker, seen = Tracker("published"), Detections.create(mask, ["thing"])
    found = [int(tracker.update(image, seen).object_id[0]) for _ in range(3)]
    assert found == [0, 0, 0]


@pytest.mark.slow
def test_a_small_mask_between_patches_is_one_object():
    """The case that founded an object in every frame."""
    image = np.random.default_rng(0).integers(0, 255, (HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    mask = np.zeros((1, HEIGHT_PX, WIDTH_PX), bool)
    mask[0, 30:60, 50:90] = True
    assert set(watch("remind", image, mask, ["thing"]).ravel()) == {0}
    seen = Detections.create(mask, ["thing"])
    published = Tracker("published")
    assert [int(published.update(image, seen).object_id[0]) for _ in range(3)] == [0, 1, 2]
