"""Every channel of a detection against the prototypes of each object (method.md#channel-scores).

An absent value is not zero: presence travels beside every score.
Letters: `N` detections, `O` objects, `A C R` channels, `S` slots.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import repeat
from remind_jax.numerics.pooling import dot
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.slices import spread_over_batch, take_slice
from remind_jax.observation import Descriptors
from remind_jax.remind.memory.prototypes import STABLE, Bank, confidence, mean_quality
from remind_jax.remind.state import TrackerState
from remind_jax.remind.thresholds import Thresholds
from remind_jax.static import Static

_SLOTS_AT_ONCE = 4


@pytree
class Score:
    """Values in [0, 1] with their presence."""

    value: Float[Array, "..."]  # 0 where absent
    present: Bool[Array, "..."]


@pytree
class ChannelScores:
    """Every channel against the banks; the first axis is that of the two, work and stable."""

    objects: Score  # [2 A N O]
    authority: Float[Array, "2 A N O"]  # how proven the winning prototype is, [0, 1]
    rings: Score  # [2 R N O]
    parts: Score  # [2 C N O]
    prototypes: Score | None = None  # [2 R N O], of the rings


def compare_channels(
    state: TrackerState, descriptors: Descriptors, static: Static, t: Thresholds
) -> ChannelScores:
    """Compares every channel with its two banks (method.md#channel-scores)."""
    background, switches = t.background.enabled, static.switches
    rings = descriptors.appearance.shape[1]  # whose channels follow those of the appearance
    vectors = jnp.concatenate([descriptors.appearance, descriptors.rings], axis=1)
    seen = [descriptors.appearance_valid, descriptors.rings_valid & background]
    wholes, authority = _best_of_bank(
        state.wholes,
        jnp.swapaxes(vectors, 0, 1),
        jnp.concatenate(seen, axis=1).T,
        t.appearance.promote_hits,
    )
    parts, parts_seen = (
        jnp.swapaxes(leaf, 0, 1) for leaf in (descriptors.parts, descriptors.parts_valid)
    )
    scores = ChannelScores(
        objects=jax.tree.map(lambda leaf: leaf[:, :rings], wholes),
        authority=authority[:, :rings],
        rings=jax.tree.map(lambda leaf: leaf[:, rings:], wholes),
        parts=_best_parts(state.parts, parts, parts_seen, switches.part_top),
    )
    if descriptors.ring_prototypes is not None and state.ring_prototypes is not None:
        patches = jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), descriptors.ring_prototypes)
        known, top = patches.valid & background, switches.ring_prototype_top
        best = _best_parts(state.ring_prototypes, patches.vector, known, top)
        scores = dataclasses.replace(scores, prototypes=best)
    if switches.banks_read == "work":
        scores = jax.tree.map(lambda leaf: leaf.at[STABLE].set(0), scores)
    return scores


def _best_of_bank(
    bank: Bank,
    vectors: Float[Array, "C N D"],
    seen: Bool[Array, "C N"],
    promote_hits: Int[Array, ""],
) -> tuple[Score, Float[Array, "... C N O"]]:
    """Best cosine per object, at least 0, and the authority of its winner."""
    best, winner = _find_nearest(bank, vectors)
    present = seen[..., None] & (best > -1.0)
    quality = jnp.clip(jnp.maximum(mean_quality(bank), bank.quality_recent), 0.0, 1.0)
    authority = jnp.clip(jnp.sqrt(quality * confidence(bank, promote_hits)), 0.0, 1.0)
    won = jnp.take_along_axis(authority[..., None, :, :], winner[..., None], axis=-1)[..., 0]
    return Score(jnp.where(present, jnp.maximum(best, 0.0), 0.0), present), won


def _best_parts(
    bank: Bank, parts: Float[Array, "C N K D"], seen: Bool[Array, "C N K"], top: int
) -> Score:
    """Mean over the `top` best matching parts of a detection (method.md#channel-scores)."""
    channels, num, clusters, dim = parts.shape
    best, _ = _find_nearest(bank, parts.reshape(channels, num * clusters, dim))
    best = best.reshape(*best.shape[:-2], num, clusters, best.shape[-1])
    best = jnp.where(seen[..., None], jnp.maximum(best, 0.0), -1.0)
    ranked = _sort_falling([best[..., part, :] for part in range(clusters)])[:top]
    total, count = jnp.zeros_like(best[..., 0, :]), jnp.int32(0)
    for one in ranked:
        total, count = total + jnp.where(one >= 0.0, one, 0.0), count + (one >= 0.0)
    present = (count > 0) & (bank.size > 0)[..., None, :]
    mean = total / jnp.maximum(count, 1)
    return Score(jnp.where(present, mean, 0.0), present)


def _find_nearest(
    bank: Bank, vectors: Float[Array, "C V D"]
) -> tuple[Float[Array, "... C V O"], Int[Array, "... C V O"]]:
    """Cosine and slot of each object's prototype that is nearest to each vector of its channel.

    The first among equals; -inf for an empty bank. Reading prototypes takes most of a step, and
    most slots are free: they are read a few at a time, as far as the fullest bank reaches.
    """
    *leading, objects, slots, dim = bank.embedding.shape
    width = min(_SLOTS_AT_ONCE, slots)
    shape = (*leading, vectors.shape[1], objects)
    # Of both banks, or the prototypes would be copied to stand side by side.
    vectors = jnp.broadcast_to(vectors, (*leading, *vectors.shape[1:]))

    def read_some(found: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        turn, best, winner = found
        # The last turn may reach back to slots that are done; they do not win a second time.
        first = jnp.minimum(turn * width, slots - width)
        some = take_slice(bank.embedding, first, width, bank.embedding.ndim - 2)
        some = some.reshape(*leading, objects * width, dim)
        cosine = dot(*spread_over_batch(vectors, some))
        cosine = cosine.reshape(*shape, width)
        for offset in range(width):
            slot = first + offset
            wins = (slot < bank.size)[..., None, :] & (cosine[..., offset] > best)
            best = jnp.where(wins, cosine[..., offset], best)
            winner = jnp.where(wins, slot, winner)
        return turn + 1, best, winner

    nothing = (jnp.full(shape, -jnp.inf, jnp.float32), jnp.zeros(shape, jnp.int32))
    turns = jax.lax.div(jnp.max(bank.size) + width - 1, jnp.int32(width))
    _, best, winner = repeat(lambda found: found[0] < turns, read_some, (jnp.int32(0), *nothing))
    return best.astype(bank.quality_sum.dtype), winner


def _sort_falling(values: list[Array]) -> list[Array]:
    """Sorts a few arrays elementwise, far faster than `jnp.sort` along a short axis."""
    for end in range(len(values) - 1, 0, -1):
        for at in range(end):
            pair = values[at], values[at + 1]
            values[at], values[at + 1] = jnp.maximum(*pair), jnp.minimum(*pair)
    return values
