"""Terms of the score are those of the tracker: the best view, both rings, the best parts."""

import numpy as np
import pytest

from remind_jax.calibration.comparisons import Comparisons, Views, compare_views


def unit(*angles):
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def views():
    angles = np.deg2rad
    return Views(
        appearance=np.stack([unit(*angles([0, 90, 60])), unit(*angles([0, 90, 30]))], axis=1),
        appearance_seen=np.array([[True, True], [True, True], [True, False]]),
        rings=np.stack([unit(*angles([0, 60, 60])), unit(*angles([0, 0, 90]))], axis=1),
        rings_seen=np.array([[True, True], [True, True], [True, False]]),
        parts=np.stack([unit(*angles([0, 0, 60])), unit(*angles([30, 90, 60]))], axis=1),
        parts_seen=np.array([[True, True], [True, False], [False, False]]),
    )


def compared(query, *memories):
    rows = [(query, np.array(memory), True, True) for memory in memories]
    return compare_views(views(), Comparisons.of(rows), (0.6, 0.4), 3)


def test_terms_of_a_query_with_memories():
    found = compared(0, [1], [2], [1, 2])
    assert found.present.tolist() == [[True] * 3, [True, True, False], [True] * 3]
    half, parts = 0.5, (1 + np.cos(np.deg2rad(30))) / 2
    wanted = [[0, 0.6 * half + 0.4, parts], [half, half, 0], [half, 0.6 * half + 0.4, parts]]
    assert found.value == pytest.approx(np.array(wanted), abs=1e-12)


def test_parts_close_to_a_stronger_one_are_dropped():
    assert views().merge_parts(0.8).parts_seen.tolist() == [
        [True, False],
        [True, False],
        [False] * 2,
    ]
    assert views().merge_parts(0.9).parts_seen.tolist() == views().parts_seen.tolist()
    assert views().part_cosines() == pytest.approx([np.cos(np.deg2rad(30))])


def test_views_of_frames_one_after_the_other():
    joined = Views.join([views(), views()])
    assert len(joined) == 6
    assert joined.num_bytes == 2 * views().num_bytes
