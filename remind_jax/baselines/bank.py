"""A bank of up to twelve views per object, all detections of a frame assigned together.

Letters: `N` detection slots, `O` object slots, `K` views of a bank, `D` feature dimension.
"""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from remind_jax.baselines.parts import scene_memory
from remind_jax.baselines.parts.masked_mean import LookedAt, describe
from remind_jax.baselines.parts.scene_memory import Matching, SceneMemory
from remind_jax.method import Host, Method, Needs, Sweeping
from remind_jax.numerics.array_faults import not_unit, outside
from remind_jax.numerics.constant_arrays import zeros
from remind_jax.numerics.pooling import dot, to_unit
from remind_jax.numerics.pytree import pytree
from remind_jax.settings.kinds import Real
from remind_jax.settings.record import setting
from remind_jax.solvers.assignment import assign
from remind_jax.static import Static

NUM_VIEWS = 12


@pytree
class BankThresholds:
    """Numbers of the bank."""

    match: Real = setting(0.75, "least cosine of a match with the most similar view", "cosine")


@pytree
class Views:
    """Views of each object; those in use come first."""

    vector: Float[Array, "O K D"]  # unit length, zero where unused
    weight: Int[Array, "O K"]  # views merged into it, 0: unused


def init(static: Static) -> SceneMemory:
    """The empty memory."""
    shape = (static.num_objects, NUM_VIEWS)
    views = Views(zeros((*shape, static.feature_dim)), zeros(shape, np.int32))
    return scene_memory.empty_memory(static, views)


def decide(
    state: SceneMemory, seen: LookedAt, *, static: Static, thresholds: BankThresholds
) -> tuple[SceneMemory, None]:
    """Maximizes the summed cosine with the most similar views, class by class; the rest is new."""
    looks, masks = seen.looks, seen.masks
    views: Views = state.looks
    each = dot(looks.vector, views.vector.reshape(-1, views.vector.shape[-1]))
    each = each.reshape(-1, *views.weight.shape)
    score = jnp.max(jnp.where(views.weight > 0, each, -1.0), axis=-1)
    allowed = (
        scene_memory.same_class(state, masks) & looks.valid[:, None] & (score >= thresholds.match)
    )
    least = jnp.full(len(masks.valid), thresholds.match, jnp.float32)
    column = assign(score, allowed, masks.class_id, least, jnp.array(True), solver=static.solver)

    def learn(views: Views, slot: Array, starts: Array) -> Views:
        weight = views.weight.at[slot].get(mode="fill", fill_value=0)
        weight = jnp.where(starts[:, None], 0, weight)
        vector = views.vector.at[slot].get(mode="fill", fill_value=0.0)
        vector, weight = jax.vmap(_add_view)(vector, weight, looks.vector)
        return Views(
            views.vector.at[slot].set(vector, mode="drop"),
            views.weight.at[slot].set(weight, mode="drop"),
        )

    matching = Matching(score, allowed, column, looks.valid, looks.valid)
    return scene_memory.conclude(state, masks, matching, learn, static, looks.num_bad_patches), None


def _add_view(
    vector: Float[Array, "K D"], weight: Int[Array, "K"], new: Float[Array, "D"]
) -> tuple[Float[Array, "K D"], Int[Array, "K"]]:
    """Adds a view; in a full bank the two most similar of all become one, so that variety stays."""
    vectors = jnp.concatenate([vector, new[None]])
    weights = jnp.concatenate([weight, jnp.ones(1, weight.dtype)])
    last = len(weight)
    apart = jnp.triu(jnp.ones((last + 1, last + 1), bool), 1)
    likeness = jnp.where(apart, dot(vectors, vectors), -jnp.inf)
    first, second = jnp.unravel_index(jnp.argmax(likeness), likeness.shape)
    merged = weights[first] * vectors[first] + weights[second] * vectors[second]
    merged_weight = weights[first] + weights[second]

    is_full = jnp.all(weight > 0)
    free = jnp.argmin(weight > 0)
    # In a full bank the pair goes to the slot of its first view, and the new one, unless it is of
    # the pair, to the slot of its second.
    full_vector = vector.at[first].set(to_unit(merged)).at[second].set(new, mode="drop")
    full_weight = weight.at[first].set(merged_weight).at[second].set(1, mode="drop")
    return (
        jnp.where(is_full, full_vector, vector.at[free].set(new)),
        jnp.where(is_full, full_weight, weight.at[free].set(1)),
    )


def _find_faults(state: SceneMemory) -> Iterator[str]:
    """As `scene_memory.find_faults`, and of the views."""
    views: Views = state.looks
    yield from scene_memory.find_faults(state)
    yield from outside("looks.weight", views.weight, 0)
    kept = np.asarray(state.objects.exists)[:, None] & (np.asarray(views.weight) > 0)
    yield from not_unit("looks.vector", views.vector, kept)


METHOD = Method(
    "bank",
    BankThresholds,
    init,
    decide,
    describe,
    Needs(patch_reach=0, reads_closeups=True),
    Host(remove=scene_memory.remove_objects, find_faults=_find_faults),
    Sweeping(described_by=()),
    title="bank of 12 + Hungarian",
)
