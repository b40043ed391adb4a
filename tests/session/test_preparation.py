"""What a frame becomes on the host, without a memory."""

import dataclasses

import numpy as np
import pytest

from remind_jax.config import load_config
from remind_jax.decision import Reason, no_decisions
from remind_jax.errors import SourceError
from remind_jax.frame import Detections, Frame
from remind_jax.method import get_method
from remind_jax.session.answers import note_omissions
from remind_jax.session.preparation import FramePreparer
from remind_jax.static import Static

SIDE, PATCH = 64, 16
CONFIG = load_config("default")


def frame_of(*labels: str, **changes) -> Frame:
    """One square per label, side by side."""
    masks = np.zeros((len(labels), SIDE, SIDE), bool)
    for row in range(len(labels)):
        masks[row, 8:40, 20 * row : 20 * row + 16] = True
    image = np.full((SIDE, SIDE, 3), 90, np.uint8)
    return dataclasses.replace(
        Frame(0, 0, 0.0, "a", image, Detections.create(masks, labels=labels)), **changes
    )


def preparer(name: str = "plus") -> FramePreparer:
    return FramePreparer(get_method(name), PATCH)


def test_ignored_classes_are_left_out_and_counted():
    prepared = preparer().prepare(frame_of("mug", "WALL", "cup"), CONFIG)
    assert prepared.detections.labels == ("mug", "cup")
    assert prepared.num_ignored == 1
    assert len(prepared.masks.valid) == 2


def test_classes_are_numbered_as_they_are_met():
    one = preparer()
    first = one.prepare(frame_of("cup", "mug"), CONFIG)
    second = one.prepare(frame_of("mug", "bowl"), CONFIG)
    assert first.masks.class_id.tolist() == [0, 1]
    assert second.masks.class_id.tolist() == [1, 2]
    assert list(one.class_ids) == ["cup", "mug", "bowl"]


def test_without_classes_all_detections_are_of_one():
    one = preparer()
    blind = one.prepare(frame_of("cup", "mug"), CONFIG.updated({"input.class_agnostic": True}))
    assert blind.masks.class_id.tolist() == [0, 0]
    assert blind.detections.labels == ("cup", "mug")


def twice(*labels: str) -> Frame:
    """Two detections of one thing, the second one the better."""
    masks = np.zeros((2, SIDE, SIDE), bool)
    masks[:, 8:40, :16] = True
    return frame_of(*labels, detections=Detections.create(masks, labels, [0.4, 0.9]))


def test_second_detections_of_one_thing_are_no_detections_unless_kept():
    doubled = twice("cup", "cup")
    prepared = preparer().prepare(doubled, CONFIG)
    assert prepared.is_double.tolist() == [True, False]
    assert prepared.masks.valid.tolist() == [False, True]
    kept = preparer().prepare(doubled, CONFIG.updated({"input.double_overlap": 0.0}))
    assert kept.masks.valid.tolist() == [True, True]


def test_second_detections_are_told_whoever_found_them():
    prepared = preparer().prepare(twice("cup", "cup"), CONFIG)
    nothing = no_decisions(Static(num_detections=4, num_objects=1))
    reason = np.array([Reason.NONE, Reason.DOUBLE, Reason.NONE, Reason.DOUBLE])
    for decisions, num in ((nothing, 1), (dataclasses.replace(nothing, reason=reason), 2)):
        (event,) = note_omissions(prepared, decisions, ())
        assert event.kind == "double"
        assert f": {num} detection" in event.message


def test_without_classes_second_detections_may_have_any_name():
    doubled = twice("cup", "mug")
    blind = CONFIG.updated({"input.class_agnostic": True})
    assert preparer().prepare(doubled, CONFIG).is_double.tolist() == [False, False]
    assert preparer().prepare(doubled, blind).is_double.tolist() == [True, False]


def test_the_previous_image_is_observed_by_methods_that_observe(monkeypatch):
    seen = []
    plus = get_method("plus")
    needs = dataclasses.replace(
        plus.needs, observe=lambda *observed: seen.append(observed), steady_light=None
    )
    method = dataclasses.replace(plus, needs=needs)
    one = FramePreparer(method, PATCH)
    for time_s, is_timed in ((5.0, True), (5.25, True), (5.25, True), (9.0, False), (9.5, True)):
        one.prepare(frame_of("mug", time_s=time_s, is_timed=is_timed), CONFIG)
    assert seen[0][0] is None
    np.testing.assert_array_equal(seen[1][0], seen[0][1])
    assert [elapsed_s for _, _, elapsed_s in seen] == [None, 0.25, None, None, None]


@pytest.mark.parametrize("passed_over", [False, True])
def test_images_are_described_in_the_first_light(passed_over):
    colors = np.random.default_rng(0).integers(40, 180, (8, 8, 3)).astype(np.uint8)
    image = np.kron(colors, np.ones((12, 12, 1), np.uint8))
    warmer = (image * [1.2, 1.0, 0.8]).astype(np.uint8)
    masks = Detections.create(np.ones((1, 96, 96), bool), ["mug"])
    first, second, third = (Frame(0, 0, 0.0, "a", one, masks) for one in (image, warmer, warmer))
    one = preparer()
    one.prepare(first, CONFIG)
    (one.pass_over if passed_over else one.prepare)(second, CONFIG)
    prepared = one.prepare(third, CONFIG)
    assert np.abs(prepared.image.astype(int) - warmer).max() > 10
    # Rounded twice, and greens may be as bright as they are now.
    assert np.median(np.abs(prepared.image.astype(int) - image)) <= 3
    np.testing.assert_array_equal(prepared.frame.image, warmer)


def test_gaps_are_measured_for_methods_with_relations_only():
    frame = frame_of("mug", "cup")
    measured, none = (
        preparer(name).prepare(frame, load_config(name)).masks.relations
        for name in ("remind", "plus")
    )
    assert measured.exact is not None
    assert measured.exact[0, 1]
    assert none.exact is None
    assert none.gap_px is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"detections": None}, "frame 'a' comes without masks; give masks or a detector"),
        ({"image": np.zeros((32, SIDE, 3), np.uint8)}, "masks of frame 'a' are 64x64 pixels"),
        ({"features": np.zeros((3, 5, 4), np.float32)}, "3x5 patches, which do not tile"),
    ],
)
def test_frames_that_disagree_are_refused(changes, message):
    with pytest.raises(SourceError, match=message):
        preparer().prepare(frame_of("mug", **changes), CONFIG)
