import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.remind.disambiguation.groups import measure_affinity

from .scenes import relations_of, thresholds

_measure = jax.jit(measure_affinity)


@pytest.mark.parametrize(
    ("change", "factor"),
    [
        ({}, 1.0),
        ({"gap_quality": 0.0}, 0.65),
        ({"truncated": True}, 0.5),
        # support 0.5: informative 1 - 0.4, agreement 0.5 + 0.25 * 0.5 instead of 0.75
        ({"support": 0.5}, 0.6 * 0.625 / 0.75),
        # touching in 4 of 4 episodes: agreement 1 instead of 0.75
        ({"contact": 3}, 1.0 / 0.75),
    ],
)
def test_affinity_weighs_what_was_seen(x64, change, factor):
    """method.md#undecided-groups, one edge in one direction: half its similarity times weight."""
    relations = relations_of(np.full((2, 2), 0.6))
    for name, value in change.items():
        old = getattr(relations, name)
        relations = dataclasses.replace(relations, **{name: np.full_like(old, value)})
    edges, contact = np.zeros((2, 2, 4)), np.zeros((2, 2, 4), np.int32)
    edges[0, 1, :3] = 0.5, 1.0, 0.5  # reliability, has a gap, distance
    contact[0, 1, 3] = 4
    affinity = _measure(
        np.array([[0], [1]]),
        np.ones((2, 1), bool),
        relations,
        edges,
        contact,
        thresholds(),
    )
    expected = 0.5 * np.exp(-0.1 / 0.2) * 0.5 * 0.75 * factor
    np.testing.assert_allclose([affinity[0, 1], affinity[1, 0]], expected, rtol=1e-12)
