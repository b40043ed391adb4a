"""One thing that a detector shows under two names, whole or under one of them cropped.

Rule: method_plus.md#cropped. Letters: `N` detections, `T` tracklets, `L` rows of classes.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.plane import overlap_of
from remind_jax.numerics.pooling import dot, to_unit
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import largest
from remind_jax.plus import thresholds as th
from remind_jax.plus.class_names import least_seen, name_odds
from remind_jax.plus.observation import Sightings
from remind_jax.plus.state import Tracklets

CROPPED_ODDS = 0.65  # share of what look and name say of a link: they change with the outline
SAME_PIXELS = 0.95  # cosine of looks above which two boxes hold the same


@pytree
class Cropped:
    """Detections whose box is that of a tracklet, cropped at one side, under another name."""

    is_pair: Bool[Array, "N T"]
    overlap: Float[Array, "N T"]  # intersection over union once both are cropped

    def at(self, origin: Int[Array, "N"]) -> Bool[Array, "N"]:
        """Detections that go on with such a tracklet."""
        found = jnp.take_along_axis(self.is_pair, jnp.maximum(origin, 0)[:, None], axis=1)[:, 0]
        return (origin != NO_SLOT) & found


def find_cropped(
    tracklets: Tracklets, sightings: Sightings, overlap: Float[Array, "N T"], t: th.Names
) -> Cropped:
    """Which detections may be tracklets of the frame before, cropped or whole again.

    Args:
      tracklets: Tracklets, carried to this frame.
      overlap: Intersection over union of their boxes as they are.
    """
    cropped = cropped_overlap(sightings.box, tracklets.box)
    renamed = sightings.class_id[:, None] != tracklets.last_class
    differs = (overlap < t.cropped) & (cropped >= t.cropped)
    return Cropped(renamed & tracklets.just_seen & differs, cropped)


def find_cropped_doubles(
    sightings: Sightings,
    origin: Int[Array, "N"],
    age: Int[Array, "N"],
    confused: Float[Array, "L L"],
    t: th.Names,
) -> Int[Array, "N"]:
    """Which detection of this frame shows the same thing as each one that is left out for it.

    Of two boxes with different names that hold the same pixels, the one stays whose tracklet has
    more detections. Of two that are the same but for one side, where the detector was seen to
    change between their names, the one that goes on with a tracklet if the other does not.

    Args:
      origin: The tracklet that each of them goes on with.
      age: The detections of that so far, 0 where there is none.
      confused: Log odds that one thing has both names (`confusion_odds`).

    Returns:
      The detection that stays for each, NO_SLOT for those that stay.
    """
    names, look, linked = sightings.class_id, to_unit(sightings.look), origin != NO_SLOT
    renamed = sightings.valid[:, None] & sightings.valid & (names[:, None] != names)
    area = sightings.size**2
    same = jnp.minimum(area[:, None], area) >= t.cropped * jnp.maximum(area[:, None], area)
    same &= overlap_of(sightings.box, sightings.box) >= t.cropped
    same &= dot(look, look) > SAME_PIXELS
    # Of those of one age, the one that the detector gave first.
    rank = age - jnp.linspace(0.0, 0.5, len(age))
    same &= rank[:, None] < rank
    cropped = cropped_overlap(sightings.box, sightings.box) >= t.cropped
    cropped &= name_odds(names, names, confused) > least_seen(t)
    cropped &= ~linked[:, None] & linked
    stays = renamed & (same | cropped)
    return jnp.where(jnp.any(stays, axis=1), largest(stays)[1], NO_SLOT)


def cropped_overlap(left: Float[Array, "N 4"], right: Float[Array, "T 4"]) -> Float[Array, "N T"]:
    """Largest intersection over union of two boxes, both cropped at one side to what they share."""
    sides = [(left[:, None, side], right[None, :, side]) for side in range(4)]
    shared = [(jnp.maximum if side < 2 else jnp.minimum)(*sides[side]) for side in range(4)]
    inner, best = _area(*shared), jnp.zeros(())
    for cropped in range(4):
        union = -inner
        for box in range(2):
            union += _area(*(shared[k] if k == cropped else sides[k][box] for k in range(4)))
        best = jnp.maximum(best, inner / jnp.maximum(union, 1e-6))
    return best


def _area(left: Array, top: Array, right: Array, bottom: Array) -> Array:
    return jnp.maximum(right - left, 0.0) * jnp.maximum(bottom - top, 0.0)
