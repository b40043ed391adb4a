"""When an undecided detection founds an object (method.md#provisional-commit).

At once: the new one of two competitors gets an id in advance and founds its object although it
stays ambiguous. Later: a new object grows out of the track of a provisional detection, which ends.
`remind.remember` calls these functions in their order.

Letters: `N` detections, `O` objects, `P` pending tracks, `K = 3` named candidates.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.ranks import rank_rising
from remind_jax.numerics.reductions import pick_in_rows, reduce_together
from remind_jax.numerics.set_order import iteration_rank
from remind_jax.remind.memory.objects import Objects, add_objects
from remind_jax.remind.memory.pending import Items, Kind, PendingTracks, dice
from remind_jax.remind.thresholds.outcome import Pending
from remind_jax.remind.undecided.temporal import PairTable, rank, to_mask


def reserve_ids(
    founder: Bool[Array, "N"],
    parent: Int[Array, "N"],
    creates: Bool[Array, "N"],
    next_id: Int[Array, ""],
) -> Int[Array, "N"]:
    """Ids in advance, by rising parent, behind all other births that the frame may bring.

    No two founders, which stay ambiguous, compete for the same parent.
    """
    turn = jnp.sum(founder & (parent < parent[:, None]), axis=1, dtype=jnp.int32)
    others = jnp.sum(creates & ~founder, dtype=jnp.int32)
    return jnp.where(founder, next_id + others + turn, NO_ID)


def find_founders(
    reserved: Int[Array, "N"], items: Items, next_id: Int[Array, ""]
) -> Bool[Array, "N"]:
    """Detections that found the object reserved for them although they stay ambiguous.

    Their own entry must name it, and no object may have taken the id by now.
    """
    named = jnp.any(items.known_id[:, :, None] == reserved, axis=1)
    named = jnp.any(named & (items.kind == Kind.AMBIGUOUS)[:, None], axis=0)
    return (reserved != NO_ID) & named & (reserved >= next_id)


def found_reserved(
    objects: Objects,
    class_id: Int[Array, "N"],
    founds: Bool[Array, "N"],
    reserved: Int[Array, "N"],
    next_id: Int[Array, ""],
) -> tuple[Objects, Int[Array, "N"], Int[Array, ""]]:
    """Creates objects by rising reserved id; ids between stay unused (method.md#object-ids)."""
    rank = rank_rising([jnp.where(founds, reserved, jnp.iinfo(jnp.int32).max)])
    objects, slot = add_objects(objects, class_id, founds, rank, reserved)
    last = jnp.max(jnp.where(founds, reserved, NO_ID))
    return objects, slot, jnp.maximum(next_id, last + 1)


def support_births(
    table: PairTable, objects: Objects, class_id: Int[Array, "N"], is_new: Bool[Array, "N"]
) -> Int[Array, "N K"]:
    """The best known objects that speak for each new detection (method.md#birth-origins).

    Which of equals are named follows the order of the original's set of a class
    (method.md#set-order); without any evidence all are equal.
    """
    score, plausible = table.pairs.score_known, table.plausible
    by_id, _ = rank(score, plausible)
    (last,) = pick_in_rows(by_id[:, -1], score)
    equal, named = plausible & (score == last[:, None]), to_mask(by_id, score.shape[1])
    tie = is_new & (by_id[:, -1] != NO_SLOT) & jnp.any(equal & ~named, axis=1)

    def by_set() -> Array:
        same = objects.exists & (objects.class_id == class_id[:, None])
        members = jnp.argsort(~same, axis=1, stable=True)
        place = jax.vmap(iteration_rank)(objects.id[members], jnp.sum(same, axis=1))
        order = jnp.take_along_axis(members, jnp.argsort(place, axis=1), axis=1)
        at, _ = rank(
            jnp.take_along_axis(score, order, axis=1), jnp.take_along_axis(plausible, order, axis=1)
        )
        slot = jnp.take_along_axis(order, jnp.maximum(at, 0), axis=1)
        return jnp.where(at == NO_SLOT, NO_SLOT, slot).astype(jnp.int32)

    return branch(jnp.any(tie), by_set, lambda: by_id)


def claim_origins(
    tracks: PendingTracks,
    is_new: Bool[Array, "N"],
    class_id: Int[Array, "N"],
    support_id: Int[Array, "N K"],
    rules: Pending,
) -> Bool[Array, "P"]:
    """Provisional tracks that end as a new object grows out of them (method.md#birth-origins)."""
    slots = tracks.kind.shape[0]
    num_named = jnp.sum(tracks.known_id >= 0, axis=1, dtype=jnp.int32)

    def claim(free: Bool[Array, "P"], one: tuple[Array, Array, Array]):
        born, kind_of, support = one
        same = free & (tracks.class_id == kind_of) & born
        num_support = jnp.sum(support >= 0, dtype=jnp.int32)
        (overlap,), _, _ = dice(support[None], tracks.known_id, num_support[None], num_named)
        fits = same & (overlap >= rules.origin_min_overlap)
        alone = same & ~tracks.from_parent
        most, num_alone = reduce_together(
            ("max", jnp.where(fits, overlap, -1.0)), ("sum", alone), axis=0
        )
        # On equal overlap the later track wins.
        latest = jnp.argmax(jnp.where(fits & (overlap == most), tracks.id, NO_ID))
        named = num_support > 0
        by_name = fits & (jnp.arange(slots) == latest) & named
        by_class = alone & ~named & (num_alone == 1)
        return free & ~(by_name | by_class), None

    waiting = tracks.kind == Kind.PROVISIONAL

    def run() -> Bool[Array, "P"]:
        free, _ = jax.lax.scan(claim, waiting, (is_new, class_id, support_id))
        return waiting & ~free

    needed = jnp.any(waiting) & jnp.any(is_new)
    return branch(needed, run, lambda: jnp.zeros(slots, bool), suits_all=True)
