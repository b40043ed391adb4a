from typing import Any

import numpy as np
from hotcoco import mask as coco_mask
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from remind_jax.frame import Rle
from remind_jax.masks.run_length import (
    cut_masks,
    decode_mask,
    encode_label_map,
    encode_masks,
    find_malformed,
    mask_areas,
    mask_box,
    union_area,
)

LABELS = arrays(
    np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 3)
)


@given(LABELS)
def test_label_maps_become_the_codes_of_their_masks(labels: np.ndarray):
    codes = encode_label_map(labels)
    assert list(codes) == [i for i in np.unique(labels).tolist() if i > 0]
    for number, code in codes.items():
        assert code == encode_masks(labels[None] == number)[0]


@given(LABELS)
def test_cut_masks_are_the_decoded_ones(labels: np.ndarray):
    planes = np.array([labels == number for number in range(4)])
    cut = cut_masks(encode_masks(planes), (labels.shape[0], labels.shape[1]))
    np.testing.assert_array_equal(np.asarray(cut), planes)


@given(st.lists(LABELS, min_size=1, max_size=5))
def test_sound_codes_pass(maps: list[np.ndarray]):
    assert find_malformed([encode_masks(labels[None] > 1)[0] for labels in maps]) is None


def read_runs(counts: bytes) -> list[int] | None:
    """Run by run, as COCO's own C code reads them; None for text that ends within a number."""
    runs: list[int] = []
    value, shift = 0, 0
    for digit in (byte - 48 for byte in counts):
        if not 0 <= digit < 64:
            return None
        value |= (digit & 31) << shift
        shift += 5
        if not digit & 32:
            value -= (digit & 16) << (shift - 4)
            runs.append(value + runs[-2] if len(runs) > 2 else value)
            value, shift = 0, 0
    return None if shift else runs


@given(st.integers(1, 40), st.integers(1, 40), st.binary(max_size=12))
def test_agrees_with_reading_run_by_run(height: int, width: int, text: bytes):
    runs = read_runs(text)
    is_sound = bool(runs) and min(runs) >= 0 and sum(runs) == height * width
    assert (find_malformed([{"size": [height, width], "counts": text}]) is None) == is_sound


@given(st.lists(st.integers(0, 70000), min_size=1, max_size=12))
def test_long_runs_add_up(runs: list[int]):
    height = max(1, sum(runs))
    runs[-1] += height - sum(runs)
    plain: Any = {"size": [height, 1], "counts": runs}
    code: Rle = coco_mask.frPyObjects(plain, height, 1)
    assert find_malformed([code]) is None
    assert find_malformed([code, {**code, "size": [height + 1, 1]}]) == 1


def test_masks_are_read_back_and_measured():
    masks = np.zeros((2, 5, 7), bool)
    masks[0, 1:3, 2:6] = True
    masks[1, 2:4, 0:3] = True
    codes = encode_masks(masks)
    np.testing.assert_array_equal([decode_mask(code) for code in codes], masks)
    assert mask_areas(codes).tolist() == [8, 6]
    assert mask_box(codes[0]) == (2, 1, 4, 2)
    assert union_area(codes) == 13
    assert encode_masks(masks[:0]) == ()
    assert union_area([]) == 0
