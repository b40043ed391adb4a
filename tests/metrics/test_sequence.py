from typing import Any

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.metrics.sequence import TrackingSequence


def create(**changes: Any) -> TrackingSequence:
    parts: dict[str, Any] = {
        "num_frames": 2,
        "ground_truth": ([0, 0, 1], [5, 6, 5]),
        "predictions": ([0, 1], [9, 9]),
        "pairs": ([0, 2], [0, 1], [0.5, 0.7]),
    }
    return TrackingSequence.create(**{**parts, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ground_truth": ([0, 0, 1], [5, 5, 5])}, r"frame 0: ground truth id 5 occurs 2 times"),
        ({"predictions": ([1, 1], [9, 9])}, r"frame 1: prediction id 9 occurs 2 times"),
        ({"predictions": ([0, 2], [9, 9])}, r"frames 0 to 1"),
        ({"predictions": ([1, 0], [9, 9])}, r"ordered by frame"),
        ({"pairs": ([0], [1], [0.5])}, r"other frames"),
        ({"pairs": ([0], [0], [1.2])}, r"1\.2 is outside of \[0, 1\]"),
        ({"pairs": ([0], [0], [np.nan])}, r"nan is outside"),
        ({"pairs": ([3], [0], [0.5])}, r"ground-truth row outside of 0 to 2"),
        ({"pairs": ([0, 0], [0, 0], [0.5, 0.5])}, r"a pair is given twice"),
        ({"predictions": ([0, 1], [9.5, 9])}, r"ids are whole numbers, found 9\.5"),
        ({"gt_class": [0]}, r"1 classes were given for 3 rows"),
    ],
)
def test_what_trackeval_refuses_is_refused(changes: dict[str, Any], message: str):
    with pytest.raises(SourceError, match=message):
        create(**changes)


def test_pairs_are_ordered_and_those_without_overlap_left_out():
    sequence = create(pairs=([2, 1, 0], [1, 0, 0], [0.7, 0.0, 0.5]))
    assert sequence.pair_gt.tolist() == [0, 2]
    assert sequence.pair_similarity.tolist() == [0.5, 0.7]
