"""The account of a step: it changes nothing, and it adds up to the decisions."""

import chex
import jax
import numpy as np
import pytest

from remind_jax.decision import Outcome
from remind_jax.numerics.absent import NO_ID
from remind_jax.remind.method import METHOD
from remind_jax.session.memory_file import SavedMemory, load_memory, save_memory
from tests import tiny_world as world
from tests.statics import change_parts, change_static

NUM_FRAMES = 24
BACKGROUND, RING_PROTOTYPES = 1, 3  # terms
WITH_PROTOTYPES = change_static(
    world.STATIC,
    ring_prototypes=True,
    ring_clusters=(2, 3),
    ring_iterations=3,
    inner_prototype_slots=(3, 2),
    outer_prototype_slots=(4, 2),
)


@pytest.fixture(scope="module")
def steps():
    """States and traces of a drawn sequence, on the host."""
    return world.trace(world.make_frames(NUM_FRAMES, seed=3))


@pytest.fixture(scope="module")
def steps_with_prototypes():
    """The same with ring prototypes."""
    thresholds = change_parts(world.THRESHOLDS, ring_prototypes={"promote_hits": 2})
    return world.trace(world.make_frames(NUM_FRAMES, seed=3), WITH_PROTOTYPES, thresholds)


def rows_of(state):
    return np.flatnonzero(state.decisions.outcome != Outcome.EMPTY)


@pytest.mark.parametrize(
    "given", ["steps", pytest.param("steps_with_prototypes", marks=pytest.mark.slow)]
)
def test_visual_score_is_the_weighted_mean_of_its_terms(given, request):
    checked = 0
    for _, trace in request.getfixturevalue(given):
        c = trace.detections.candidates
        weight = np.where(c.present, c.weight, 0.0)
        total = weight.sum(axis=-1)
        shown = (c.id != NO_ID) & (total > 1e-6)
        mean = (weight * c.value).sum(axis=-1)[shown] / total[shown]
        # float32: sums of three or four products in [0, 1].
        np.testing.assert_allclose(c.visual_score[shown], mean, atol=1e-6)
        if given == "steps_with_prototypes":
            # Both look at the background, so its quality weighs both.
            share = c.weight[..., RING_PROTOTYPES][shown] / c.weight[..., BACKGROUND][shown]
            np.testing.assert_allclose(share, 0.05 / 0.25, rtol=1e-6)
            shown &= c.present[..., RING_PROTOTYPES]
        checked += shown.sum()
    assert checked > 50


@pytest.mark.slow
def test_ring_prototypes_survive_growth_and_files(steps_with_prototypes, tmp_path):
    state, path = steps_with_prototypes[-1][0], tmp_path / "memory.safetensors"
    names = tuple(f"class {number}" for number in range(int(state.objects.class_id.max()) + 1))
    save_memory(path, SavedMemory(state, WITH_PROTOTYPES, names, "test"))
    kept = load_memory(path).state
    chex.assert_trees_all_equal(kept, state)
    grown = METHOD.enlarge(kept, change_static(WITH_PROTOTYPES, num_objects=11)).ring_prototypes
    num = WITH_PROTOTYPES.num_objects
    for ours, theirs in zip(
        jax.tree.leaves(grown), jax.tree.leaves(state.ring_prototypes), strict=True
    ):
        np.testing.assert_array_equal(ours[:, :, :num], theirs[:, :, :num])
        np.testing.assert_array_equal(ours[:, :, 11:], theirs[:, :, num:])


def test_candidates_are_those_of_the_decisions_by_falling_score(steps):
    for state, trace in steps:
        c, d = trace.detections.candidates, state.decisions
        for row in rows_of(state):
            shown = c.id[row][c.id[row] != NO_ID]
            assert len(set(shown.tolist())) == len(shown)
            assert np.all(np.diff(c.visual_score[row][: len(shown)]) <= 0)
            if trace.detections.num_candidates[row] <= d.candidate_id.shape[1]:
                assert shown.tolist() == d.candidate_id[row][: len(shown)].tolist()
