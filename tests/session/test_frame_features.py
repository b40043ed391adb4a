"""Features of the patches that a method reads, and of no others; of frames and of closeups."""

import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.backbone import Backbone, get_backbone
from remind_jax.config import load_config
from remind_jax.crops import Crops
from remind_jax.errors import ConfigError, RemindError
from remind_jax.frame import Detections, Frame
from remind_jax.masks.closeups import CLOSEUP_PATCHES, cut_closeups
from remind_jax.method import get_method, list_methods
from remind_jax.observation import CloseupFeats, FrameFeats
from remind_jax.session.frame_features import CLOSEUPS_AT_ONCE, FrameFeatures
from remind_jax.session.live import Tracker
from tests.cli import scenes

PATCH_PX, HEIGHT, WIDTH = 8, scenes.HEIGHT_PX, scenes.WIDTH_PX
GARBAGE = 77.0
ROOM = {"static": {"num_detections": 4, "num_objects": 16, "num_pending": 4}}
METHODS = [name for name in list_methods() if get_method(name).needs.patch_reach is not None]
CLOSEUP_METHODS = [name for name in list_methods() if get_method(name).needs.reads_closeups]


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
    for frame in range(num):
        image, labels = scenes.picture(frame, () if frame == 2 else scenes.FIRST_THREE)
        yield image, scenes.masks_of(labels)


def frame_of(image: np.ndarray | None, masks: np.ndarray, **more) -> Frame:
    return Frame(0, 0, 0.0, "one", image, Detections.create(masks, ["a"] * len(masks)), **more)


def frame_tracker(name: str, backbone: Backbone) -> Tracker:
    return Tracker(ROOM, backbone, tracker=name)


def closeup_tracker(name: str = "plus", backbone: Backbone | None = None, **options) -> Tracker:
    config = {"tracker": name, "input": {"closeups": "always", **options}, **ROOM}
    return Tracker(config, backbone or Recorder().whole)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        pytest.param(make, name, marks=[pytest.mark.heavy] if name == "plus" else [])
        for make, names in ((frame_tracker, METHODS), (closeup_tracker, CLOSEUP_METHODS))
        for name in names
    ],
)
def test_no_method_reads_features_that_it_does_not_ask_for(make, name):
    whole, part = Recorder(), Recorder()
    one, other = make(name, whole.whole), make(name, part.in_part)
    for image, masks in frames(6):
        one.update(image, masks)
        other.update(image, masks)
        jax.tree.map(np.testing.assert_array_equal, one.state, other.state)
    assert int(one.state.frame) == 6
    if make is frame_tracker:
        assert not any(wanted is None or np.all(wanted) for wanted in part.wanted)
    else:
        shape = (CLOSEUPS_AT_ONCE, CLOSEUP_PATCHES, CLOSEUP_PATCHES)
        assert {np.asarray(wanted).shape for wanted in part.wanted} == {shape}


def test_plus_asks_for_objects_and_what_is_around_them():
    recorder = Recorder()
    tracker = Tracker(backbone=recorder.in_part)
    mask = np.zeros((1, HEIGHT, WIDTH), bool)
    mask[0, 40, 63:65] = True  # one pixel of each of two patches
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    tracker.describe(tracker.prepare(frame_of(image, mask)))
    expected = np.zeros((1, HEIGHT // PATCH_PX, WIDTH // PATCH_PX), bool)
    expected[0, 3:8, 5:11] = True
    np.testing.assert_array_equal(recorder.wanted[0], expected)


def test_a_method_that_reads_all_gets_all():
    recorder, (image, masks) = Recorder(), next(frames(1))
    tracker = Tracker(backbone=recorder.in_part, tracker="bank")
    method = dataclasses.replace(
        tracker.method, needs=dataclasses.replace(tracker.method.needs, patch_reach=None)
    )
    prepared = tracker.prepare(frame_of(image, masks))
    seen = FrameFeatures(method, recorder.in_part).describe(prepared, tracker.static)
    assert recorder.wanted == [None]
    np.testing.assert_array_equal(seen.patches, describe(image[None])[0])


@pytest.mark.parametrize("num", [0, 1, CLOSEUPS_AT_ONCE, CLOSEUPS_AT_ONCE + 3])
def test_any_number_of_closeups_is_described_in_batches_of_one_size(num):
    recorder, rng = Recorder(), np.random.default_rng(num)
    tracker = closeup_tracker(backbone=recorder.whole)
    image = rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    masks = np.zeros((num, HEIGHT, WIDTH), bool)
    for row in range(num):
        masks[row, 8 * row : 8 * row + 7, 20:40] = True
    seen = tracker.describe(tracker.prepare(frame_of(image, masks)))
    assert isinstance(seen, CloseupFeats)
    expected = describe(cut_closeups(image, masks, PATCH_PX).images)
    np.testing.assert_array_equal(seen.patches, expected)
    assert len(recorder.wanted) == max(1, -(-num // CLOSEUPS_AT_ONCE))


def test_closeups_are_of_masks_after_erosion():
    image, masks = next(frames(1))
    prepared = closeup_tracker(erosion_px=2).prepare(frame_of(image, masks))
    eroded = Crops.of(masks).eroded(2, margin_px=0)
    assert prepared.closeups is not None
    expected = cut_closeups(image, eroded, PATCH_PX).coverage
    np.testing.assert_array_equal(prepared.closeups.coverage, expected)


def test_plus_takes_closeups_of_itself_where_the_backbone_describes_them():
    frame = frame_of(*next(frames(1)))
    near = get_backbone()
    far = Recorder().whole

    def has_closeups(name: str, backbone: Backbone, choice: str) -> bool:
        config = {"tracker": name, "input": {"closeups": choice}}
        return Tracker(config, backbone).prepare(frame).closeups is not None

    assert has_closeups("plus", near, "auto")
    assert not has_closeups("plus", far, "auto")
    assert not has_closeups("plus", near, "never")
    assert has_closeups("plus", far, "always")
    assert not has_closeups("bank", near, "auto")
    assert has_closeups("bank", far, "always")
    assert not has_closeups("remind", near, "auto")
    with pytest.raises(ConfigError, match=r"input\.closeups is 'always', but tracker 'remind'"):
        has_closeups("remind", near, "always")


def test_frames_that_bring_features_are_not_looked_at_again():
    _, masks = next(frames(1))
    features = np.ones((HEIGHT // PATCH_PX, WIDTH // PATCH_PX, 9), np.float32)
    tracker = closeup_tracker()
    prepared = tracker.prepare(frame_of(None, masks, features=features))
    assert isinstance(tracker.describe(prepared), FrameFeats)


def test_frames_that_bring_features_are_not_scaled():
    width = load_config("default").input.max_width_px + 8 * PATCH_PX
    masks, features = np.zeros((1, 64, width), bool), np.ones((4, width // 16, 9), np.float32)
    masks[0, 16:48, 16:64] = True
    prepared = closeup_tracker().prepare(frame_of(None, masks, features=features))
    assert prepared.masks.coverage.shape[1:] == features.shape[:2]


@pytest.mark.heavy
def test_a_memory_of_closeups_takes_no_frames(tmp_path):
    tracker, file = closeup_tracker(), tmp_path / "memory.safetensors"
    for image, masks in frames(3):
        tracker.update(image, masks)
    tracker.save(file)
    closeup_tracker().load(file)
    with pytest.raises(RemindError, match="closeups"):
        closeup_tracker(closeups="never").load(file)
