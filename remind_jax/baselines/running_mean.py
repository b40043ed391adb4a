"""Nearest neighbor: one running mean per object, the most similar pair first.

Letters: `O` object slots, `D` feature dimension.
"""

from __future__ import annotations

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from remind_jax.baselines.parts import scene_memory
from remind_jax.baselines.parts.masked_mean import LookedAt, describe
from remind_jax.baselines.parts.scene_memory import Matching, SceneMemory
from remind_jax.method import Host, Method, Needs, Sweeping
from remind_jax.numerics.array_faults import outside
from remind_jax.numerics.constant_arrays import zeros
from remind_jax.numerics.pooling import dot, to_unit
from remind_jax.numerics.pytree import pytree
from remind_jax.settings.kinds import Real
from remind_jax.settings.record import setting
from remind_jax.solvers.greedy import assign_greedily
from remind_jax.static import Static


@pytree
class RunningMeanThresholds:
    """Numbers of the running mean."""

    match: Real = setting(0.75, "least cosine of a match", "cosine")


@pytree
class Means:
    """The mean of all views of each object."""

    vector: Float[Array, "O D"]
    count: Int[Array, "O"]  # views


def init(static: Static) -> SceneMemory:
    """The empty memory."""
    num, dim = static.num_objects, static.feature_dim
    return scene_memory.empty_memory(static, Means(zeros((num, dim)), zeros(num, np.int32)))


def decide(
    state: SceneMemory, seen: LookedAt, *, static: Static, thresholds: RunningMeanThresholds
) -> tuple[SceneMemory, None]:
    """Matches by falling cosine with the mean of all earlier views; who is left is new."""
    looks, masks = seen.looks, seen.masks
    score = dot(looks.vector, to_unit(state.looks.vector))
    allowed = scene_memory.same_class(state, masks) & looks.valid[:, None]
    least = jnp.full(len(masks.valid), thresholds.match, jnp.float32)
    column = assign_greedily(score, allowed, least, jnp.array(True))

    def learn(means: Means, slot: Array, starts: Array) -> Means:
        before = jnp.where(starts, 0, means.count.at[slot].get(mode="fill", fill_value=0))
        old = means.vector.at[slot].get(mode="fill", fill_value=0.0)
        new = old + (looks.vector - old) / (before[:, None] + 1)
        return Means(
            means.vector.at[slot].set(new, mode="drop"),
            means.count.at[slot].set(before + 1, mode="drop"),
        )

    matching = Matching(score, allowed, column, looks.valid, looks.valid)
    return scene_memory.conclude(state, masks, matching, learn, static, looks.num_bad_patches), None


def _find_faults(state: SceneMemory) -> Iterator[str]:
    """As `scene_memory.find_faults`, and of the means."""
    yield from scene_memory.find_faults(state)
    yield from outside("looks.count", state.looks.count, 0)


METHOD = Method(
    "running-mean",
    RunningMeanThresholds,
    init,
    decide,
    describe,
    Needs(patch_reach=0, reads_closeups=True),
    Host(remove=scene_memory.remove_objects, find_faults=_find_faults),
    Sweeping(described_by=()),
    title="nearest running mean",
)
