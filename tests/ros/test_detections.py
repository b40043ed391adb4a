from types import SimpleNamespace

import numpy as np
import pytest

from remind_jax.crops import Crops
from remind_jax.errors import SourceError
from remind_ros.detections import read_detections
from tests.ros import messages

SIZE = (20, 30)


def test_boxes_stand_in_for_masks():
    seen = read_detections(SIZE, None, messages.boxes([(2, 3, 6, 8)], ["7"]), {"7": "mug"})
    rows, columns = np.nonzero(seen.masks[0])
    assert (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) == (2, 3, 6, 8)
    assert seen.labels == ("mug",)
    assert seen.scores.tolist() == [0.75]


def test_a_quarter_turn_exchanges_the_sides():
    turned = messages.boxes([(10, 4, 18, 8)], ["mug"], theta=np.pi / 2)
    upright = messages.boxes([(12, 2, 16, 10)], ["mug"])
    np.testing.assert_array_equal(
        read_detections(SIZE, None, turned, {}).masks,
        read_detections(SIZE, None, upright, {}).masks,
    )


def test_a_map_alone_names_its_instances():
    numbers = np.zeros(SIZE, int)
    numbers[:4], numbers[10:] = 5, 2
    seen = read_detections(SIZE, numbers, None, {})
    assert seen.labels == ("object", "object")
    np.testing.assert_array_equal(seen.masks, [numbers == 2, numbers == 5])


def test_a_map_beside_boxes_gives_their_pixels():
    numbers = np.zeros(SIZE, int)
    numbers[:4] = 2
    given = messages.boxes([(0, 0, 9, 9), (0, 0, 9, 9)], ["mug", "bowl"])
    seen = read_detections(SIZE, numbers, given, {})
    assert seen.labels == ("mug", "bowl")
    assert Crops.of(seen.masks).areas.tolist() == [0, 4 * 30]


def test_detections_without_hypotheses_are_objects():
    given = messages.boxes([(0, 0, 9, 9)], ["mug"])
    given.detections[0].results = []
    seen = read_detections(SIZE, None, given, {})
    assert (seen.labels, seen.scores.tolist()) == (("object",), [1.0])


def test_no_detections_are_no_detections():
    assert len(read_detections(SIZE, None, messages.boxes([], []), {})) == 0
    assert len(read_detections(SIZE, np.zeros(SIZE, int), None, {})) == 0


@pytest.mark.parametrize("side", [np.nan, np.inf, 2.0])
def test_impossible_boxes_are_refused(side):
    given = messages.boxes([(5, 5, side, 9)], ["mug"])  # 2 is left of 5
    with pytest.raises(SourceError, match="must be finite, its size not negative"):
        read_detections(SIZE, None, given, {})


def test_far_boxes_are_cut_off():
    given = messages.boxes([(-1e12, -1e12, 1e12, 1e12)], ["wall"])
    assert np.all(read_detections(SIZE, None, given, {}).masks)


def test_what_does_not_fit_is_refused():
    with pytest.raises(SourceError, match="neither an instance map nor detections"):
        read_detections(SIZE, None, None, {})
    with pytest.raises(SourceError, match="4x3 pixels and the image 30x20"):
        read_detections(SIZE, np.zeros((3, 4), int), None, {})


def test_detections_of_ros_1_are_read_too():
    """There a center has no position of its own, and results are the hypotheses."""
    center = SimpleNamespace(x=5.0, y=5.0, theta=0.0)
    one = SimpleNamespace(
        bbox=SimpleNamespace(center=center, size_x=4.0, size_y=6.0),
        results=[SimpleNamespace(id=7, score=0.5), SimpleNamespace(id=3, score=1.0000001)],
    )
    seen = read_detections(SIZE, None, SimpleNamespace(detections=[one]), {"3": "mug"})
    assert (seen.labels, seen.scores.tolist()) == (("mug",), [1.0])
    assert Crops.of(seen.masks).box(0) == (3, 2, 4, 6)
