"""Detections of a frame."""

import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.frame import Detections, Frame, check_frame, frame_of


@pytest.mark.parametrize(
    ("keep", "left"),
    [([2, 0], ("c", "a")), ([False, True, False], ("b",)), ([], ()), (np.zeros(3, bool), ())],
)
def test_select_takes_indices_a_mask_or_nothing(keep, left):
    detections = Detections.create(np.ones((3, 2, 2)), ["a", "b", "c"], instance_ids=[1, 2, 3])
    chosen = detections.select(keep)
    assert chosen.labels == left
    assert len(chosen.masks) == len(chosen.scores) == len(chosen.instance_ids) == len(left)


def test_pictures_and_features_may_be_those_of_another_library():
    class Tensor:
        dtype = "tensor.float32"

        def __array__(self, *_, **__):
            return np.ones((2, 2, 3), np.float32)

    frame = Frame(0, 0, 0.0, "", jnp.ones((4, 4, 3), jnp.uint8), features=Tensor())
    check_frame(frame)
    assert type(frame.image) is type(frame.features) is np.ndarray


def test_a_frame_beyond_all_measure_is_refused():
    """One that repeats a pixel takes no memory, but libraries that count its bytes break."""
    image = np.broadcast_to(np.uint8(3), (100_000, 100_000, 3))
    with pytest.raises(SourceError, match="frames of 100000x100000 pixels cannot be tracked"):
        check_frame(frame_of(image, 0))


def test_a_list_of_rows_is_selected_and_nothing_else():
    detections = Detections.create(np.ones((2, 2, 2)))
    for wrong in (0, True, [[0, 1]], 2**63):
        with pytest.raises(SourceError, match="cannot be selected"):
            detections.select(wrong)
