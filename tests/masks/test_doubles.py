"""Second detections of one thing."""

import numpy as np
import pytest

from remind_jax.crops import Crops
from remind_jax.masks.doubles import find_doubles


def block(left, right):
    mask = np.zeros((8, 40), bool)
    mask[2:6, left:right] = True
    return mask


def doubles(blocks, labels, scores, least=0.5):
    masks = Crops.of(np.stack([block(*one) for one in blocks]))
    return find_doubles(masks, labels, np.array(scores, np.float32), least).tolist()


def test_the_lesser_of_two_of_a_class_that_overlap_is_a_second_one():
    blocks = [(0, 10), (1, 11), (1, 11), (20, 30)]
    labels = ["cup", "cup", "bowl", "cup"]
    assert doubles(blocks, labels, [0.5, 0.9, 0.3, 0.9]) == [True, False, False, False]
    assert doubles(blocks, labels, [0.5, 0.5, 0.3, 0.9]) == [False, True, False, False]


@pytest.mark.parametrize(("shift", "is_double"), [(3, True), (4, False)])
def test_overlap_is_intersection_over_union(shift, is_double):
    # 7 of 13 columns are more than half, 6 of 14 less.
    assert doubles([(0, 10), (shift, 10 + shift)], "aa", [0.9, 0.8])[1] is is_double


def test_a_part_and_its_whole_are_two_and_what_is_left_out_leaves_nothing_out():
    assert doubles([(0, 20), (0, 8)], "aa", [0.9, 0.8]) == [False, False]
    assert doubles([(0, 10), (3, 13), (6, 16)], "aaa", [0.9, 0.8, 0.7]) == [False, True, False]


def test_empty_masks_and_no_threshold_leave_all():
    assert doubles([(0, 0), (0, 0)], "aa", [1, 1]) == [False, False]
    assert doubles([(0, 9), (0, 9)], "aa", [1, 1], least=0) == [False, False]
    assert doubles([(0, 9), (0, 9)], "aa", [1, 1], least=1) == [False, True]
