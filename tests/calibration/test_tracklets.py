"""Links that are certain: boxes of one class that overlap each other most."""

import numpy as np

from remind_jax.calibration.reading import NONE, Boxes, link_boxes


def frame(*lefts: float, kind: int = 0, valid: bool = True) -> Boxes:
    """Boxes of 10 pixels side by side."""
    box = np.array([[left, 0.0, left + 10.0, 10.0] for left in lefts])
    num = len(lefts)
    return Boxes(0, box, np.full(num, valid), np.full(num, kind))


def link(*frames: Boxes) -> list[list[int]]:
    return [tracks.tolist() for tracks in link_boxes(frames)]


def test_boxes_that_move_a_little_are_one_tracklet():
    assert link(frame(0, 50), frame(52, 2)) == [[0, 1], [1, 0]]


def test_a_jump_another_class_or_a_gap_ends_a_tracklet():
    frames = (frame(0), frame(8), frame(8, kind=1), frame(8, kind=1, valid=False), frame(8, kind=1))
    assert link(*frames) == [[0], [1], [2], [NONE], [3]]


def test_two_that_claim_one_are_not_both_linked():
    assert link(frame(0, 100), frame(0, 3))[1] == [0, 2]
