from __future__ import annotations

import math

import numpy as np
import pytest

from remind_jax.metrics.hota import ALPHAS, count_hota, hota_scores
from remind_jax.metrics.sequence import TrackingSequence
from tests.metrics.tables import sequence_from_answers


@pytest.mark.parametrize(
    ("lines", "det", "ass"),
    [
        (["aaaaaaaaaa"], 1, 1),
        (["aaaaaabbbb"], 1, (6 * 0.6 + 4 * 0.4) / 10),
        (["aaaaa", "bbbbb"], 1, 1),
        (["aaaaabbbbb", "bbbbbaaaaa"], 1, 1 / 3),
        (["aaa??aa"], 5 / 7, 5 / 7),
        (["?????"], 0, 0),
    ],
)
def test_hand_made_tables(lines: list[str], det: float, ass: float):
    scores = hota_scores(count_hota(sequence_from_answers(*lines)))
    # Products of a few exact fractions: rounding only.
    np.testing.assert_allclose(scores["DetA"], det, rtol=1e-14)
    np.testing.assert_allclose(scores["AssA"], ass, rtol=1e-14)
    np.testing.assert_allclose(scores["HOTA"], math.sqrt(det * ass), rtol=1e-14)


def test_a_similarity_on_a_threshold_is_a_match():
    for index, alpha in enumerate(ALPHAS):
        sequence = TrackingSequence.from_frames([[1]], [[1]], [[[float(alpha)]]])
        assert count_hota(sequence).true_positives.sum() == index + 1


def test_localization_is_the_mean_similarity_of_matches():
    sequence = TrackingSequence.from_frames([[1], [1]], [[1], [1]], [[[0.52]], [[0.82]]])
    scores = hota_scores(count_hota(sequence))
    assert scores["LocA"][0] == pytest.approx(0.67)  # both matched
    assert scores["LocA"][12] == pytest.approx(0.82)  # one, at 0.65
    assert scores["LocA"][18] == 1.0  # none, by convention
