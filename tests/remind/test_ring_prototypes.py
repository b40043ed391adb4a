"""The whole step with ring prototypes: the fourth term, their banks, and where they are kept."""

from __future__ import annotations

import dataclasses

import chex
import jax
import numpy as np
import pytest

from remind_jax.numerics.absent import NO_ID
from remind_jax.remind.method import METHOD
from remind_jax.session.memory_file import SavedMemory, load_memory, save_memory
from tests import tiny_world as world
from tests.statics import change_static

NUM_FRAMES = 16
STATIC = change_static(
    world.STATIC,
    ring_prototypes=True,
    ring_clusters=(2, 3),
    ring_iterations=3,
    inner_prototype_slots=(3, 2),
    outer_prototype_slots=(4, 2),
)
THRESHOLDS = dataclasses.replace(
    world.THRESHOLDS,
    ring_prototypes=dataclasses.replace(world.THRESHOLDS.ring_prototypes, promote_hits=2),
)
BACKGROUND, RING_PROTOTYPES = 1, 3  # terms


@pytest.fixture(scope="module")
def steps():
    """States and traces of a drawn sequence, on the host."""
    return world.trace(world.make_frames(NUM_FRAMES, seed=3), STATIC, THRESHOLDS)


@pytest.mark.slow
def test_visual_score_has_a_fourth_term(steps):
    checked = 0
    for _, trace in steps:
        c = trace.detections.candidates
        weight = np.where(c.present, c.weight, 0.0)
        total = weight.sum(axis=-1)
        shown = (c.id != NO_ID) & (total > 1e-6)
        mean = (weight * c.value).sum(axis=-1)[shown] / total[shown]
        # float32: sums of four products in [0, 1].
        np.testing.assert_allclose(c.visual_score[shown], mean, atol=1e-6)
        # Both look at the background, so its quality weighs both.
        share = c.weight[..., RING_PROTOTYPES][shown] / c.weight[..., BACKGROUND][shown]
        np.testing.assert_allclose(share, 0.05 / 0.25, rtol=1e-6)
        checked += (shown & c.present[..., RING_PROTOTYPES]).sum()
    assert checked > 50


@pytest.mark.slow
def test_they_survive_growth_and_files(steps, tmp_path):
    state = steps[-1][0]
    path = tmp_path / "memory.safetensors"
    names = tuple(f"class {number}" for number in range(int(state.objects.class_id.max()) + 1))
    save_memory(path, SavedMemory(state, STATIC, names, "test"))
    kept = load_memory(path).state
    chex.assert_trees_all_equal(kept, state)
    larger = change_static(STATIC, num_objects=11)
    grown = METHOD.enlarge(kept, larger).ring_prototypes
    assert grown is not None
    for ours, theirs in zip(
        jax.tree.leaves(grown), jax.tree.leaves(state.ring_prototypes), strict=True
    ):
        np.testing.assert_array_equal(
            ours[:, :, : STATIC.num_objects], theirs[:, :, : STATIC.num_objects]
        )
        np.testing.assert_array_equal(ours[:, :, 11:], theirs[:, :, STATIC.num_objects :])
