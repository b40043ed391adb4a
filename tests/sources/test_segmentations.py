import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from remind_jax.sources.segmentations import decode_segmentation
from remind_jax.sources.source import UnreadableFrame
from tests.sources.test_coco_masks import encode


@given(hnp.arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 40))))
@settings(deadline=None)
def test_codes_of_pycocotools_are_read(mask):
    assert decode_segmentation(encode(mask), mask.shape).tolist() == mask.tolist()


def test_plain_run_lengths_and_polygons():
    plain = {"size": [2, 3], "counts": [1, 2, 3]}
    assert decode_segmentation(plain, (2, 3)).tolist() == [
        [False, True, False],
        [True, False, False],
    ]
    square = decode_segmentation([[2, 2, 8, 2, 8, 6, 2, 6]], (10, 10))
    assert square[2:6, 2:8].all()
    assert square.sum() == 24


@pytest.mark.parametrize(
    "segmentation",
    [
        {"size": [4, 6], "counts": "0000000000000000000000000000000"},
        {"size": [2, 2], "counts": "0h0"},
        {"size": [400, 600], "counts": "0h0"},
        {"size": [4, 6], "counts": ""},
        {"size": [4, 6], "counts": "\x7f\x7f"},
        {"size": [4, 6], "counts": "o"},
        {"size": [4, 6], "counts": [5, 900]},
        {"size": [4, 6], "counts": [-5, 29]},
        {"size": [4], "counts": "0h0"},
        {"counts": "0h0"},
        [[1, 2]],
        [["a"]],
        [[0, 0, 1e30, 0, 5, 5]],
        [[0, 0, float("nan"), 0, 5, 5]],
        "0h0",
        7,
    ],
)
def test_malformed_codes_never_reach_pycocotools(segmentation):
    with pytest.raises(UnreadableFrame):
        decode_segmentation(segmentation, (4, 6))


@settings(max_examples=200)
@given(st.text("0123456789:;<=>?@ABCDEFGHIJKLMNOPQRSTUVWXYZ[]^_`abcdefghijklmno", max_size=12))
def test_random_codes_are_decoded_or_refused(counts):
    try:
        mask = decode_segmentation({"size": [3, 4], "counts": counts}, (3, 4))
    except UnreadableFrame:
        return
    assert mask.shape == (3, 4)
