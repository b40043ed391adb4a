from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pycocotools import mask as coco_mask

from remind_jax.masks.run_length import encode_masks
from remind_jax.metrics.run_lengths import encode_label_map, find_malformed
from remind_jax.sources.coco_masks import decode_segmentation
from remind_jax.sources.source import UnreadableFrame
from remind_jax.tracks import Rle

LABELS = arrays(
    np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 3)
)


@given(LABELS)
def test_label_maps_become_the_codes_of_their_masks(labels: np.ndarray):
    codes = encode_label_map(labels)
    assert list(codes) == [i for i in np.unique(labels).tolist() if i > 0]
    for number, code in codes.items():
        assert code == encode_masks(labels[None] == number)[0]


@given(st.lists(LABELS, min_size=1, max_size=5))
def test_sound_codes_pass(maps: list[np.ndarray]):
    assert find_malformed([encode_masks(labels[None] > 1)[0] for labels in maps]) is None


@given(st.integers(1, 40), st.integers(1, 40), st.binary(max_size=12))
def test_agrees_with_reading_run_by_run(height: int, width: int, text: bytes):
    code: Rle = {"size": [height, width], "counts": text}
    try:
        decode_segmentation(code, (height, width))
        is_sound = True
    except UnreadableFrame:
        is_sound = False
    assert (find_malformed([code]) is None) == is_sound


@given(st.lists(st.integers(0, 70000), min_size=1, max_size=12))
def test_long_runs_add_up(runs: list[int]):
    height = max(1, sum(runs))
    runs[-1] += height - sum(runs)
    plain: Any = {"size": [height, 1], "counts": runs}
    code: Rle = coco_mask.frPyObjects(plain, height, 1)
    assert find_malformed([code]) is None
    assert find_malformed([code, {**code, "size": [height + 1, 1]}]) == 1


@pytest.mark.parametrize("text", [b"", b"o", b"\x00", b"~~~~"])
def test_damaged_codes_are_found(text: bytes):
    good = encode_masks(np.ones((1, 4, 4), bool))[0]
    assert find_malformed([good, {"size": [4, 4], "counts": text}, good]) == 1
    assert find_malformed([]) is None
