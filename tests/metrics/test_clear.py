from __future__ import annotations

import pytest

from remind_jax.metrics.clear import clear_scores, count_clear
from tests.metrics.tables import from_frames


def test_continuity_beats_a_better_overlap():
    better_other = [[0.6, 0.9]]
    sequence = from_frames([[1], [1]], [[7], [7, 8]], [[[0.9]], better_other])
    counts = count_clear(sequence)
    assert counts.switches == 0
    assert counts.similarity_sum == pytest.approx(1.5)


def test_continuity_looks_at_the_previous_frame_with_predictions():
    overlaps = [[[0.9]], [[]], [[0.6, 0.9]]]
    sequence = from_frames([[1], [1], [1]], [[7], [], [7, 8]], overlaps)
    assert count_clear(sequence).switches == 0


def test_without_truth_one_sequence_and_a_sum_differ_as_in_trackeval():
    counts = count_clear(from_frames([[]], [[1, 2]], [[]]))
    assert clear_scores(counts)["MOTA"] == 0
    assert clear_scores(counts, pooled=True)["MOTA"] == -2
