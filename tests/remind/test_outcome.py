"""What is written down about each detection (method.md#outcomes)."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.numerics.absent import NO_ID
from remind_jax.remind.association.similarity import Comparison
from remind_jax.remind.outcome import rank_candidates
from remind_jax.remind.state import init
from tests.remind.association.tables import SLOTS, STATIC, decide_frames, visual_frame
from tests.statics import only

RANK = jax.jit(rank_candidates, static_argnums=2)


def test_candidates_are_listed_by_falling_score_then_rising_id(x64):
    d = decide_frames([visual_frame([{0: 0.5, 1: 0.9, 2: 0.5, 3: 0.7}])]).decisions
    assert d.candidate_id[0, 0].tolist() == [1, 3, 0, 2] + [NO_ID] * (SLOTS - 4)
    np.testing.assert_allclose(d.candidate_score[0, 0, :5], [0.9, 0.7, 0.5, 0.5, 0])
    assert d.candidate_eligible[0, 0].tolist() == [True] + [False] * (SLOTS - 1)


def test_more_candidates_shown_than_objects_and_fewer(x64):
    objects = init(STATIC).objects
    ids = jnp.where(jnp.arange(SLOTS) < 3, 10 + jnp.arange(SLOTS), NO_ID)
    objects = dataclasses.replace(objects, id=ids)
    table = jnp.tile(jnp.array([0.1, 0.3, 0.2] + [0.0] * (SLOTS - 3)), (2, 1))
    candidate = jnp.arange(SLOTS)[None] < jnp.array([[3], [1]])
    comparison = only(Comparison, candidate=candidate, score=table)
    for shown in (2, SLOTS + 3):
        listed, rows = RANK(objects, comparison, shown)
        expected = [[11, 12, 10], [10, NO_ID, NO_ID]]
        assert listed.shape == rows.shape == (2, shown)
        assert [row[:3] for row in listed.tolist()] == [row[:shown] for row in expected]
