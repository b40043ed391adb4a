"""What decided detections teach about their objects.

Rules: method_plus.md#relation-learning, method_plus.md#look-learning.

Letters: `N` detections, `O` object slots, `K` kept looks, `D` feature dimension. Lengths in frame
units.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.plus import thresholds as th
from remind_jax.plus.decision import Choice
from remind_jax.plus.observation import Sightings
from remind_jax.plus.state import UNRELATED, Objects, Pairs, Scene, Tracklets
from remind_jax.plus.whitening import whiten


def learn_relations(
    objects: Objects,
    pairs: Pairs,
    slot: Int[Array, "N"],
    sure: Bool[Array, "N"],
    sightings: Sightings,
    t: th.Layout,
) -> Pairs:
    """Stores how all objects lie from those in view, and who is in view together.

    Objects out of view count where the map has them, so that a camera which pans across relates
    objects that are never seen together.
    """
    num_o = len(objects.id)
    is_at = (slot[:, None] == jnp.arange(num_o)) & sure[:, None]
    visible = jnp.any(is_at, axis=0)

    def at_slots(values: Array) -> Array:
        return jnp.matmul(is_at.T.astype(jnp.float32), values, precision="highest")

    place = jnp.where(visible[:, None], at_slots(sightings.center), objects.position)
    size = jnp.where(visible, at_slots(sightings.size), objects.size)
    border = at_slots(sightings.touches.astype(jnp.float32))
    doubt = jnp.where(visible, 0.0, jnp.sqrt(jnp.maximum(jnp.diag(pairs.covariance), 0.0)))

    scale = jnp.sqrt(size[:, None] * size[None, :])
    spread = (doubt[:, None] + doubt[None, :]) / scale
    spread += t.border_error * (border[:, None] + border[None, :])
    one_visible = visible[:, None] | visible[None, :]
    both_exist = objects.exists[:, None] & objects.exists[None, :]
    accepted = one_visible & both_exist & ~jnp.eye(num_o, dtype=bool)
    accepted &= (spread <= pairs.spread + t.spread_slack) & (spread < t.spread_max)
    alike = jnp.abs(spread - pairs.spread) < t.spread_same
    rate = jnp.where(accepted, jnp.where(alike, t.rate, 1.0), 0.0)

    relation = (place[None, :] - place[:, None]) / scale[..., None]
    log_ratio = jnp.log(size[:, None] / size[None, :])
    together = (visible[:, None] & visible[None, :]).astype(jnp.float32)
    return dataclasses.replace(
        pairs,
        covisible=pairs.covisible + together,
        relation=pairs.relation + rate[..., None] * (relation - pairs.relation),
        spread=pairs.spread + rate * (spread - pairs.spread),
        log_ratio=pairs.log_ratio + rate * (log_ratio - pairs.log_ratio),
    )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class KeptLooks:
    """Looks that are to be kept, in turn; those of one turn are of different objects."""

    slot: Int[Array, "R N"]  # object
    look: Float[Array, "R N D"]
    keeps: Bool[Array, "R N"]

    @classmethod
    def of_ended(cls, tracklets: Tracklets, ended: Bool[Array, "T"], num: int) -> KeptLooks:
        """Those of tracklets that ended out of view, `num` in a turn; the first are in view."""
        slot, look, ended = (
            leaf[num:].reshape(-1, num, *leaf.shape[1:])
            for leaf in (tracklets.slot, tracklets.look, ended)
        )
        return cls(slot, look, ended)

    @classmethod
    def of_absorbed(
        cls,
        objects: Objects,
        slot: Int[Array, "N"],
        into: Int[Array, "N"],
        absorbed: Bool[Array, "N"],
    ) -> KeptLooks:
        """Those of objects that turned out to be known ones, one of each in a turn."""
        source = jnp.where(absorbed, slot, 0)
        looks, counts = objects.bank[source], objects.bank_count[source]
        return cls(
            jnp.broadcast_to(into, (counts.shape[1], len(into))),
            jnp.swapaxes(looks, 0, 1),
            (absorbed[:, None] & (counts > 0)).T,
        )


def learn_objects(
    objects: Objects,
    scene: Scene,
    here: Tracklets,
    sure: Bool[Array, "N"],
    sightings: Sightings,
    waiting: KeptLooks,
    frame: Int[Array, ""],
    t: th.Memory,
) -> Objects:
    """Looks, backgrounds, sizes and counts of the objects in view; `waiting` is kept before."""
    num_o = len(objects.id)
    slot = jnp.where(sure, here.slot, num_o)  # out of range: written nowhere
    row = jnp.where(sure, here.slot, 0)
    seen = objects.seen.at[slot].add(1, mode="drop")
    last = objects.last.at[slot].set(frame, mode="drop")
    size = jnp.where(
        sightings.touches, jnp.maximum(objects.size[row], sightings.size), sightings.size
    )
    turn = (here.age % t.every == 1) & ~(sightings.touches & (here.age > t.border_age))
    ring_count = objects.ring_count[row] + sightings.has_ring
    rate = sightings.has_ring / jnp.maximum(ring_count, 1)
    ring = objects.ring[row] + rate[:, None] * (sightings.ring - objects.ring[row])
    objects = dataclasses.replace(
        objects,
        seen=seen,
        last=last,
        size=objects.size.at[slot].set(size, mode="drop"),
        ring=objects.ring.at[slot].set(ring, mode="drop"),
        ring_count=objects.ring_count.at[slot].set(ring_count, mode="drop"),
    )
    now = KeptLooks(here.slot[None], sightings.look[None], (sure & turn)[None])
    turns = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), waiting, now)
    last = len(turns.keeps) - 1

    def keep(k: Array, objects: Objects) -> Objects:
        slot, keeps = turns.slot[k], turns.keeps[k]
        # An object without any look keeps what is seen of it, whosever turn it is.
        empty = ~jnp.any(objects.bank_count[jnp.where(sure, slot, 0)] > 0, axis=1)
        keeps |= (k == last) & sure & empty
        return keep_looks(objects, scene, slot, turns.look[k], keeps, t)

    # Most frames have nothing but what is in view.
    first = jnp.argmax(jnp.any(turns.keeps[:last], axis=1))
    first = jnp.where(jnp.any(turns.keeps[:last]), first, last)
    return lax.fori_loop(first, last + 1, keep, objects)


def keep_looks(
    objects: Objects,
    scene: Scene,
    slot: Int[Array, "N"],
    look: Float[Array, "N D"],
    keeps: Bool[Array, "N"],
    t: th.Memory,
) -> Objects:
    """Adds looks to the banks of different objects, into the nearest kept one where it is close."""
    row = jnp.where(keeps, slot, 0)
    bank, count = objects.bank[row], objects.bank_count[row]
    white, white_look = objects.white_bank[row], whiten(scene, look)
    used = count > 0
    cosine = jnp.where(used, jnp.einsum("nke,ne->nk", white, white_look, precision="highest"), -2.0)
    is_close = (jnp.max(cosine, axis=1) > t.novel) | jnp.all(used, axis=1)
    at = jnp.where(is_close, jnp.argmax(cosine, axis=1), jnp.argmin(used, axis=1))
    index = jnp.arange(len(row))
    old_count = jnp.where(is_close, count[index, at], 0)
    rate = 1.0 / jnp.minimum(old_count + 1.0, t.rate_samples)
    old = jnp.where(is_close[:, None], bank[index, at], 0.0)
    new = old + rate[:, None] * (look - old)
    target = jnp.where(keeps, slot, len(objects.id))
    return dataclasses.replace(
        objects,
        bank=objects.bank.at[target, at].set(new, mode="drop"),
        bank_count=objects.bank_count.at[target, at].set(old_count + 1, mode="drop"),
        white_bank=objects.white_bank.at[target, at].set(whiten(scene, new), mode="drop"),
    )


def create_objects(
    objects: Objects,
    pairs: Pairs,
    tracklets: Tracklets,
    born: Bool[Array, "T"],
    place_variance: Float[Array, "T"],
) -> tuple[Objects, Pairs, Int[Array, "T"]]:
    """Gives new objects the lowest free slots, in the order of the tracklets.

    Returns:
      Objects, pairs, and the slot of each tracklet (its own before where nothing was created).
    """
    num_o = len(objects.id)
    free = jnp.argsort(objects.exists, stable=True)
    rank = jnp.cumsum(born) - 1
    slot = jnp.where(born, free[jnp.clip(rank, 0, num_o - 1)], tracklets.slot).astype(jnp.int32)
    at = jnp.where(born, slot, num_o)

    def put(values: Array, new: Array | float) -> Array:
        return values.at[at].set(jnp.asarray(new, values.dtype), mode="drop")

    objects = dataclasses.replace(
        objects,
        id=put(objects.id, tracklets.id),
        class_id=put(objects.class_id, tracklets.class_id),
        seen=put(objects.seen, 0),
        last=put(objects.last, tracklets.last),
        size=put(objects.size, tracklets.size),
        bank_count=put(objects.bank_count, 0),
        ring=put(objects.ring, 0.0),
        ring_count=put(objects.ring_count, 0),
        position=put(objects.position, tracklets.center),
    )
    is_new = jnp.zeros(num_o, bool).at[at].set(True, mode="drop")
    pairs = forget_pairs(pairs, is_new)
    covariance = pairs.covariance.at[at, at].set(place_variance, mode="drop")
    return objects, dataclasses.replace(pairs, covariance=covariance), slot


def forget_pairs(pairs: Pairs, forgotten: Bool[Array, "O"]) -> Pairs:
    """Clears what is known between some objects and all others."""
    clear = forgotten[:, None] | forgotten[None, :]
    return Pairs(
        covariance=jnp.where(clear, 0.0, pairs.covariance),
        covisible=jnp.where(clear, 0.0, pairs.covisible),
        relation=jnp.where(clear[..., None], 0.0, pairs.relation),
        spread=jnp.where(clear, UNRELATED, pairs.spread),
        log_ratio=jnp.where(clear, 0.0, pairs.log_ratio),
    )


def absorb(
    objects: Objects,
    pairs: Pairs,
    slot: Int[Array, "N"],
    into: Int[Array, "N"],
    absorbed: Bool[Array, "N"],
) -> tuple[Objects, Pairs]:
    """Hands all but the looks of objects that turned out to be known ones to those; frees slots.

    Args:
      objects: Objects.
      pairs: Pairs.
      slot: Object of each detection.
      into: The known object that it is.
      absorbed: Detections whose object is absorbed.
    """
    num_o = len(objects.id)
    source = jnp.where(absorbed, slot, 0)
    goal = jnp.where(absorbed, into, num_o)
    row = jnp.where(absorbed, into, 0)
    own, more = objects.ring_count[row], objects.ring_count[source]
    share = (more / jnp.maximum(own + more, 1))[:, None]
    ring = objects.ring[row] + share * (objects.ring[source] - objects.ring[row])
    gone = jnp.zeros(num_o, bool).at[jnp.where(absorbed, slot, num_o)].set(True, mode="drop")
    added = jnp.zeros_like(pairs.covisible).at[goal].add(pairs.covisible[source], mode="drop")
    # The diagonal counts sights of one object and is no pair.
    added = jnp.where(jnp.eye(num_o, dtype=bool), 0.0, added)
    pairs = dataclasses.replace(pairs, covisible=pairs.covisible + added + added.T)
    objects = dataclasses.replace(
        objects,
        seen=objects.seen.at[goal].add(objects.seen[source], mode="drop"),
        ring=objects.ring.at[goal].set(ring, mode="drop"),
        ring_count=objects.ring_count.at[goal].set(own + more, mode="drop"),
    )
    objects = dataclasses.replace(
        objects,
        id=jnp.where(gone, -1, objects.id),
        class_id=jnp.where(gone, -1, objects.class_id),
        bank_count=jnp.where(gone[:, None], 0, objects.bank_count),
    )
    return objects, forget_pairs(pairs, gone)


def learn_cosines(
    scene: Scene,
    here: Tracklets,
    sure: Bool[Array, "N"],
    choice: Choice,
    cosine: Float[Array, "N O"],
    frame: Int[Array, ""],
    t: th.Calibration,
) -> Scene:
    """Learns what cosines of the same and of other objects look like.

    Rule: method_plus.md#calibration.

    Args:
      scene: Statistics so far.
      here: Tracklets of the detections.
      sure: Those whose object is decided.
      choice: Decisions of this frame.
      cosine: Best cosine of each look with each object.
      frame: Number of this frame.
      t: Weights.
    """
    num_o = cosine.shape[1]
    # Objects clearly recognized teach what the same object looks like after an absence.
    clear = choice.recognized & (choice.margin >= t.sure_margin)
    same = [jnp.where(clear, t.sure_weight, 0.0), choice.cosine]

    old = sure & (here.age >= t.min_age) & (frame % t.every == 0)
    now_and_first = jnp.sum(whiten(scene, here.look) * whiten(scene, here.first_look), axis=-1)
    aged = [jnp.where(old, t.same_weight, 0.0), now_and_first]

    held = jnp.where(sure, here.slot, num_o)
    other = cosine[:, jnp.minimum(held, num_o - 1)]  # [N N]
    apart = (held[:, None] != held[None, :]) & old[:, None] & sure[None, :]
    alike = here.class_id[:, None] == here.class_id[None, :]
    weight = jnp.where(apart, jnp.where(alike, t.other_weight, t.foreign_weight), 0.0)

    def moments(weight: Array, value: Array) -> Array:
        return jnp.stack([jnp.sum(weight), jnp.sum(weight * value), jnp.sum(weight * value**2)])

    new = jnp.stack([moments(weight, other), moments(*same) + moments(*aged)])
    fade = t.decay ** new[:, 0]
    return dataclasses.replace(
        scene, cosines=scene.cosines * fade[:, None] + new, faded=scene.faded * fade
    )
