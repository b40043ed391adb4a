"""What decided detections teach about their objects.

Rules: method_plus.md#relation-learning, method_plus.md#look-learning.

Letters: `N` detections, `O` object slots, `K` kept looks, `D` feature dimension. Lengths in frame
units.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import count_up, fill_blocks
from remind_jax.numerics.plane import log_ratios, mean_sizes
from remind_jax.numerics.pooling import dot
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import largest
from remind_jax.plus import thresholds as th
from remind_jax.plus.class_names import name_row, vote
from remind_jax.plus.decision import Choice
from remind_jax.plus.evidence import BORDER_ERROR, COSINE_DECAY
from remind_jax.plus.observation import Sightings
from remind_jax.plus.own_movement import forgetting_speed
from remind_jax.plus.slots import NO_ROW, rows_of
from remind_jax.plus.small_matrices import diagonal
from remind_jax.plus.state import UNRELATED, Objects, Pairs, Scene, Tracklets
from remind_jax.plus.static import NAME_ROWS, OBJECTS_BLOCK
from remind_jax.plus.whitening import adjust_cosine, class_offset, whiten

# Relations that are stored, by their spreads, object sizes.
SPREAD_MAX = 4.0  # those that are less certain are not
SPREAD_SLACK = 0.02  # a new one may be this much less certain than the stored one
SPREAD_SAME = 0.1  # those of about the same certainty are averaged, ...
RELATION_RATE = 0.3  # ... with this weight of the new one
# Looks that are kept.
KEEP_EVERY = 2  # a look is learned once in so many detections
BORDER_AGE = 8  # detections; later looks at the border are not kept ...
KNOWN_AGE = 40  # ... up to this age: what was seen for so long is known however it is cut off
# Cosines that teach, and their weights.
TEACH_EVERY = 2  # ticks
TEACH_AGE = 8  # detections of a tracklet that teaches
SAME_WEIGHT = 0.5  # now and first sight of a tracklet
OTHER_WEIGHT = 0.5  # other objects of the class in view
FOREIGN_WEIGHT = 0.1  # objects of other classes in view
ABSENT_WEIGHT = 0.5  # other known objects of the class, ...
ABSENT_MOST = 5.0  # ... of which so many count
SURE_WEIGHT = 2.0  # a clearly recognized object: ...
SURE_MARGIN = 3.0  # ... its lead, log odds


def learn_relations(
    objects: Objects,
    pairs: Pairs,
    row: Int[Array, "O"],
    sightings: Sightings,
    tick: Float[Array, ""],
    t: th.Mobility,
) -> Pairs:
    """Stores how all objects lie from those in view, and who is in view together.

    Objects out of view count where the map has them, so that a camera which pans across relates
    objects that are never seen together. What was known of slots that are free now is forgotten.

    Args:
      row: Detection of each object, NO_ROW out of view.
    """
    visible = row != NO_ROW
    # A relation is forgotten as fast as its objects move.
    every = _Placed(
        slot=jnp.arange(len(row)),
        exists=objects.exists,
        visible=visible,
        place=jnp.where(visible[:, None], sightings.center[row], objects.position),
        size=jnp.where(visible, sightings.size[row], objects.size),
        border=jnp.where(visible & sightings.touches[row], BORDER_ERROR, 0.0),
        doubt=jnp.where(visible, 0.0, jnp.sqrt(jnp.maximum(diagonal(pairs.covariance), 0.0))),
        speed=tick * forgetting_speed(objects, t),
    )
    known = pairs.covisible, pairs.relation, pairs.spread, pairs.log_ratio

    def relate(rows_of: Callable[[Array], Array]) -> tuple[Array, ...]:
        block = jax.tree.map(rows_of, every)
        covisible, relation, spread, log_ratio = map(rows_of, known)
        scale = mean_sizes(block.size, every.size)
        error = (block.doubt[:, None] + every.doubt) / scale + (
            block.border[:, None] + every.border
        )
        both_visible = block.visible[:, None] & every.visible
        both_exist = block.exists[:, None] & every.exists
        accepted = (block.visible[:, None] | every.visible) & both_exist
        accepted &= block.slot[:, None] != every.slot
        aged = spread + (block.speed[:, None] + every.speed) / scale
        aged = jnp.where(aged < SPREAD_MAX, aged, UNRELATED)
        accepted &= (error <= aged + SPREAD_SLACK) & (error < SPREAD_MAX)
        alike = jnp.abs(error - aged) < SPREAD_SAME
        rate = jnp.where(accepted, jnp.where(alike, RELATION_RATE, 1.0), 0.0)
        offset = (every.place - block.place[:, None]) / scale[..., None]
        relation += rate[..., None] * (offset - relation)
        log_ratio += rate * (log_ratios(block.size, every.size) - log_ratio)
        return (
            jnp.where(both_exist, covisible + both_visible, 0.0),
            jnp.where(both_exist[..., None], relation, 0.0),
            jnp.where(both_exist, aged + rate * (error - aged), UNRELATED),
            jnp.where(both_exist, log_ratio, 0.0),
        )

    covisible, relation, spread, log_ratio = fill_blocks(
        relate, objects.exists, known, OBJECTS_BLOCK
    )
    return dataclasses.replace(
        pairs, covisible=covisible, relation=relation, spread=spread, log_ratio=log_ratio
    )


class _Placed(NamedTuple):
    """Where objects are, and how well that is known."""

    slot: Int[Array, "O"]
    exists: Bool[Array, "O"]
    visible: Bool[Array, "O"]
    place: Float[Array, "O 2"]
    size: Float[Array, "O"]
    border: Float[Array, "O"]  # error of what touches the border, sizes
    doubt: Float[Array, "O"]  # standard deviation of the place
    speed: Float[Array, "O"]


@pytree
class KeptLooks:
    """Looks that may be kept, one after the other."""

    slot: Int[Array, "R"]  # object
    look: Float[Array, "R D"]
    keeps: Bool[Array, "R"]

    @classmethod
    def in_view(
        cls,
        objects: Objects,
        here: Tracklets,
        sure: Bool[Array, "N"],
        counts: Bool[Array, "N"],
        sightings: Sightings,
    ) -> KeptLooks:
        """Those of decided detections, once in some detections, and of objects without any."""
        turn = counts & (here.age % KEEP_EVERY == 1)
        turn &= ~(sightings.touches & (here.age > BORDER_AGE) & (here.age <= KNOWN_AGE))
        is_empty = jnp.all(objects.bank_count == 0, axis=1)[here.slot]
        return cls(here.slot, sightings.look, sure & (turn | is_empty))


def learn_objects(
    objects: Objects,
    row: Int[Array, "O"],
    sightings: Sightings,
    frame: Int[Array, ""],
) -> Objects:
    """Classes, backgrounds, sizes and counts of the objects in view.

    Args:
      row: Detection of each, NO_ROW out of view.
    """
    visible, size = row != NO_ROW, sightings.size[row]
    size = jnp.where(sightings.touches[row], jnp.maximum(objects.size, size), size)
    has_ring = visible & sightings.has_ring[row]
    ring_count = objects.ring_count + has_ring
    class_id, lead = vote(objects.class_id, objects.class_lead, sightings.class_id[row], visible)
    rate = has_ring / jnp.maximum(ring_count, 1)
    step = jnp.where(has_ring[:, None], sightings.ring[row] - objects.ring, 0.0)
    return dataclasses.replace(
        objects,
        class_id=class_id,
        class_lead=lead,
        seen=objects.seen + visible,
        last=jnp.where(visible, frame, objects.last),
        size=jnp.where(visible, size, objects.size),
        ring=objects.ring + rate[:, None] * step,
        ring_count=ring_count,
    )


class _Banks(NamedTuple):
    """What objects keep of looks, one row an object."""

    look: Float[Array, "O K D"]
    counts: Int[Array, "O K"]
    white: Float[Array, "O K E"]


def keep_looks(
    objects: Objects, scene: Scene, groups: Sequence[KeptLooks], t: th.Memory
) -> Objects:
    """Adds looks to the banks of their objects, group after group."""
    slot = jnp.concatenate([group.slot for group in groups])
    keeps = jnp.concatenate([group.keeps for group in groups])
    index = jnp.arange(len(slot), dtype=jnp.int32)

    def read(k: Array) -> Float[Array, "D"]:
        look, start = groups[0].look[k], len(groups[0].slot)
        for group in groups[1:]:
            look = jnp.where(k >= start, group.look[k - start], look)
            start += len(group.slot)
        return look

    def keep(_: Array, before: tuple[Array, _Banks]) -> tuple[Array, _Banks]:
        at, banks = before
        left = keeps & (index > at)
        at = jnp.min(jnp.where(left, index, len(slot) - 1))
        row = slot[at]
        offset = class_offset(scene, objects.class_id[row])
        return at, _keep_look(banks, scene, row, read(at), offset, jnp.any(left), t)

    banks = _Banks(objects.bank, objects.bank_count, objects.white_bank)
    banks = count_up(jnp.sum(keeps), keep, (jnp.int32(-1), banks), suits_all=True)[1]
    return dataclasses.replace(
        objects, bank=banks.look, bank_count=banks.counts, white_bank=banks.white
    )


def _keep_look(
    banks: _Banks,
    scene: Scene,
    row: Int[Array, ""],
    look: Float[Array, "D"],
    offset: Float[Array, "D"],
    keeps: Bool[Array, ""],
    t: th.Memory,
) -> _Banks:
    """Adds a look to the bank of an object, into the nearest kept one where it is close."""
    count = banks.counts[row]
    cosine = adjust_cosine(scene, dot(banks.white[row], whiten(scene, look - offset)[None])[:, 0])
    # A free place is taken by what is nowhere nearer than the novel may be.
    at = largest(jnp.where(count > 0, cosine, t.novel))[1]
    is_joined = (jnp.arange(len(count)) == at) & (count > 0)
    num = jnp.sum(jnp.where(is_joined, count, 0))
    old = jnp.sum(jnp.where(is_joined[:, None], banks.look[row], 0.0), axis=0)
    rate = 1.0 / jnp.minimum(num + 1.0, t.rate_samples)
    new = old + rate * (look - old)

    def put(values: Array, value: Array) -> Array:
        start = (row, at, *(jnp.int32(0),) * (values.ndim - 2))
        # Where JAX computes in 64 bits, so does a sum of counts.
        value = jnp.where(keeps, value.astype(values.dtype), values[row, at])
        return lax.dynamic_update_slice(values, value[None, None], start)

    return _Banks(*map(put, banks, (new, num + 1, whiten(scene, new - offset))))


def learn_cosines(
    scene: Scene,
    objects: Objects,
    here: Tracklets,
    sure: Bool[Array, "N"],
    choice: Choice,
    cosine: Float[Array, "N O"],
    since_first: Float[Array, "N"],
    share: Float[Array, "N"],
    ticks: Int[Array, ""],
) -> Scene:
    """Learns what cosines of the same and of other objects look like, in all and class by class.

    Rule: method_plus.md#calibration.

    Args:
      sure: Those whose object is decided.
      cosine: Best cosine of each look with each object.
      since_first: Cosine of each look with the first one of its tracklet.
      share: How much each detection teaches.
    """
    num_o = cosine.shape[1]
    # Objects clearly recognized teach what the same object looks like after an absence.
    clear = choice.recognized & (choice.margin >= SURE_MARGIN)
    old = sure & (here.age >= TEACH_AGE) & (ticks % TEACH_EVERY == 0)
    same = jnp.stack([choice.cosine, since_first])
    same_weight = jnp.stack(
        [jnp.where(clear, SURE_WEIGHT, 0.0), jnp.where(old, SAME_WEIGHT * share, 0.0)]
    )

    is_own = here.slot[:, None] == jnp.arange(num_o)
    # What began in this frame was compared with nothing.
    was_compared = jnp.any(objects.bank_count > 0, axis=1)
    apart = was_compared[None] & ~is_own & old[:, None]
    alike = here.class_id[:, None] == objects.class_id[None]
    row = rows_of(here.slot, sure, num_o)
    beside = (row != NO_ROW)[None] & apart
    known = apart & alike & ~beside & ~here.fresh[:, None]
    few = jnp.minimum(1.0, ABSENT_MOST / jnp.maximum(jnp.sum(known, axis=1, keepdims=True), 1))
    weight = jnp.where(beside, jnp.where(alike, OTHER_WEIGHT, FOREIGN_WEIGHT), 0.0)
    weight = weight + jnp.where(known, ABSENT_WEIGHT * few, 0.0)
    # A pair teaches as much as the less known of the two.
    shares = jnp.where(row != NO_ROW, share[row], 0.0)
    weight = weight * jnp.maximum(share[:, None], shares[None, :])

    def moments(weight: Array, value: Array, axis: int) -> Float[Array, "3 *any"]:
        powers = weight, weight * value, weight * value**2
        return jnp.stack([jnp.sum(power, axis=axis) for power in powers])

    own = moments(same_weight, same, 0)
    of_others = moments(jnp.where(alike, weight, 0.0), cosine, 1)
    of_foreign = moments(jnp.where(alike, 0.0, weight), cosine, 1)
    of_all = jnp.stack([jnp.sum(of_others + of_foreign, axis=1), jnp.sum(own, axis=1)], axis=1)
    num, once, squares = of_all
    fade = COSINE_DECAY**num
    of_row = jnp.stack([of_others, own], axis=1)
    is_of_class = name_row(here.class_id)[:, None] == jnp.arange(NAME_ROWS)
    of_class = jnp.sum(jnp.where(is_of_class, of_row[..., None], 0.0), axis=2)
    return dataclasses.replace(
        scene,
        cosine_weight=scene.cosine_weight * fade + num,
        cosine_sum=scene.cosine_sum * fade + once,
        cosine_squares=scene.cosine_squares * fade + squares,
        faded=scene.faded * fade,
        class_cosines=scene.class_cosines * COSINE_DECAY ** of_class[0] + of_class,
    )
