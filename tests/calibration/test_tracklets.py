"""Links that are certain: boxes of one class that overlap each other most."""

import numpy as np

from remind_jax.calibration.reading import NONE, link_boxes


def box(left, size=10.0):
    return [left, 0.0, left + size, 10.0]


def test_boxes_that_move_a_little_are_one_tracklet():
    boxes = np.array([[box(0), box(50)], [box(52), box(2)]])
    tracks = link_boxes(boxes, np.ones((2, 2), bool), np.zeros((2, 2), int))
    assert tracks.tolist() == [[0, 1], [1, 0]]


def test_a_jump_another_class_or_a_gap_ends_a_tracklet():
    boxes = np.array([[box(0)], [box(8)], [box(8)], [box(8)], [box(8)]])
    valid = np.array([[True], [True], [True], [False], [True]])
    kind = np.array([[0], [0], [1], [1], [1]])
    assert link_boxes(boxes, valid, kind)[:, 0].tolist() == [0, 1, 2, NONE, 3]


def test_two_that_claim_one_are_not_both_linked():
    boxes = np.array([[box(0), box(100)], [box(0), box(3)]])
    tracks = link_boxes(boxes, np.ones((2, 2), bool), np.zeros((2, 2), int))
    assert tracks[1].tolist() == [0, 2]
