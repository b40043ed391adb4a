"""Detections of a frame."""

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.frame import Detections, check_frame, frame_of


@pytest.mark.parametrize(
    ("keep", "left"),
    [([2, 0], ("c", "a")), ([False, True, False], ("b",)), ([], ()), (np.zeros(3, bool), ())],
)
def test_select_takes_indices_a_mask_or_nothing(keep, left):
    detections = Detections.create(np.ones((3, 2, 2)), ["a", "b", "c"], instance_ids=[1, 2, 3])
    chosen = detections.select(keep)
    assert chosen.labels == left
    assert len(chosen.masks) == len(chosen.scores) == len(chosen.instance_ids) == len(left)


@pytest.mark.parametrize("labels", [{"cup", "mug"}, {"cup": 1, "mug": 2}])
def test_what_has_no_order_is_no_list_of_labels(labels):
    with pytest.raises(SourceError, match=r"labels are a (set|dict), which has no order; give one"):
        Detections.create(np.ones((2, 4, 4)), labels)


def test_a_frame_beyond_all_measure_is_refused():
    """One that repeats a pixel takes no memory, but libraries that count its bytes break."""
    image = np.broadcast_to(np.uint8(3), (100_000, 100_000, 3))
    with pytest.raises(SourceError, match="frames of 100000x100000 pixels cannot be tracked"):
        check_frame(frame_of(image, 0))


def test_one_text_is_no_list_of_labels():
    """Else it would be taken for one label per letter."""
    with pytest.raises(SourceError, match="labels are one text, 'mug'; give one name per mask"):
        Detections.create(np.ones((3, 4, 4), bool), labels="mug")  # pyright: ignore
