"""Detections of a frame."""

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.frame import Detections


@pytest.mark.parametrize(
    ("keep", "left"),
    [([2, 0], ("c", "a")), ([False, True, False], ("b",)), ([], ()), (np.zeros(3, bool), ())],
)
def test_select_takes_indices_a_mask_or_nothing(keep, left):
    detections = Detections.create(np.ones((3, 2, 2)), ["a", "b", "c"], instance_ids=[1, 2, 3])
    chosen = detections.select(keep)
    assert chosen.labels == left
    assert len(chosen.masks) == len(chosen.scores) == len(chosen.instance_ids) == len(left)


def test_one_text_is_no_list_of_labels():
    """Else it would be taken for one label per letter."""
    with pytest.raises(SourceError, match="labels are one text, 'mug'; give one name per mask"):
        Detections.create(np.ones((3, 4, 4), bool), labels="mug")  # pyright: ignore
