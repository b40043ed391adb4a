from __future__ import annotations

import numpy as np
import pytest

from remind_jax.metrics.identity import count_identity, identity_scores
from remind_jax.metrics.sequence import TrackingSequence
from tests.metrics.tables import sequence_from_answers


@pytest.mark.parametrize(
    ("lines", "right", "missing", "wrong"),
    [
        (["aaaaaaaaaa"], 10, 0, 0),
        (["aaaaaabbbb"], 6, 4, 4),
        (["aaaaabaaaa", "....ccccc."], 14, 1, 1),
        (["aaaaaa....", "......aaaa"], 6, 4, 4),
        (["aaa??aa"], 5, 2, 0),
        (["???"], 0, 3, 0),
        (["aaaabb", "bbbbaa"], 8, 4, 4),
    ],
)
def test_hand_made_tables(lines: list[str], right: int, missing: int, wrong: int):
    counts = count_identity(sequence_from_answers(*lines))
    assert counts.true_positives == right
    assert counts.false_negatives == missing
    assert counts.false_positives == wrong
    assert identity_scores(counts)["IDF1"] == 2 * right / (2 * right + missing + wrong)


@pytest.mark.parametrize(("overlap", "right"), [(0.5, 1), (np.nextafter(0.5, 0), 0)])
def test_a_half_is_enough(overlap: float, right: int):
    sequence = TrackingSequence.from_frames([[1]], [[1]], [[[overlap]]])
    assert count_identity(sequence).true_positives == right


def test_false_positives_count():
    sequence = TrackingSequence.from_frames([[1], []], [[1], [2, 3]], [[[0.9]], np.zeros((0, 2))])
    assert identity_scores(count_identity(sequence))["IDP"] == pytest.approx(1 / 3)
