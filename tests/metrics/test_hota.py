from __future__ import annotations

from remind_jax.metrics.hota import ALPHAS, count_hota
from tests.metrics.tables import from_frames


def test_a_similarity_on_a_threshold_is_a_match():
    for index, alpha in enumerate(ALPHAS):
        sequence = from_frames([[1]], [[1]], [[[float(alpha)]]])
        assert count_hota(sequence).true_positives.sum() == index + 1
