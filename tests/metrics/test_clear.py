from __future__ import annotations

from remind_jax.metrics.clear import clear_scores, count_clear
from tests.metrics.tables import from_frames


def test_without_truth_one_sequence_and_a_sum_differ_as_in_trackeval():
    counts = count_clear(from_frames([[]], [[1, 2]], [[]]))
    assert clear_scores(counts)["MOTA"] == 0
    assert clear_scores(counts, pooled=True)["MOTA"] == -2
