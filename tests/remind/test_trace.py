"""The account of a step: it changes nothing, and it adds up to the decisions."""

from __future__ import annotations

import chex
import jax
import numpy as np
import pytest

from remind_jax.decision import Outcome
from remind_jax.numerics.absent import NO_ID
from remind_jax.remind.method import METHOD
from remind_jax.remind.state import init
from tests import tiny_world as world

NUM_FRAMES = 24


@pytest.fixture(scope="module")
def steps():
    """States and traces of a drawn sequence, on the host."""
    return world.trace(world.make_frames(NUM_FRAMES, seed=3))


@pytest.mark.slow
def test_tracing_changes_nothing(steps):
    plain = jax.jit(METHOD.step, static_argnames="static")
    thresholds = world.THRESHOLDS.as_arrays(world.STATIC.scalar)
    state = init(world.STATIC)
    for frame, (traced, _) in zip(world.make_frames(NUM_FRAMES, seed=3), steps, strict=True):
        state = plain(state, *frame, static=world.STATIC, thresholds=thresholds)
        # Two programs: the compiler may order sums otherwise, by a bit or two.
        chex.assert_trees_all_close(traced, jax.device_get(state), rtol=1e-7, atol=2e-6)


def rows_of(state):
    return np.flatnonzero(state.decisions.outcome != Outcome.EMPTY)


def test_visual_score_is_the_weighted_mean_of_its_terms(steps):
    checked = 0
    for _, trace in steps:
        c = trace.detections.candidates
        weight = np.where(c.present, c.weight, 0.0)
        total = weight.sum(axis=-1)
        shown = (c.id != NO_ID) & (total > 1e-6)
        mean = (weight * c.value).sum(axis=-1)[shown] / total[shown]
        # float32: sums of three products in [0, 1].
        np.testing.assert_allclose(c.visual_score[shown], mean, atol=1e-6)
        checked += shown.sum()
    assert checked > 100


def test_candidates_are_those_of_the_decisions_by_falling_score(steps):
    for state, trace in steps:
        c, d = trace.detections.candidates, state.decisions
        for row in rows_of(state):
            shown = c.id[row][c.id[row] != NO_ID]
            assert len(set(shown.tolist())) == len(shown)
            assert np.all(np.diff(c.visual_score[row][: len(shown)]) <= 0)
            if trace.detections.num_candidates[row] <= d.candidate_id.shape[1]:
                assert shown.tolist() == d.candidate_id[row][: len(shown)].tolist()
