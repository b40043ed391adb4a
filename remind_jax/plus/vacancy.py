"""Empty places: an object that is not where it should be in view was moved, or taken away.

Rule: method_plus.md#empty-places.

Letters: `N` detections, `O` object slots. Lengths are in frame units.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.plus import thresholds as th
from remind_jax.plus.evidence import relation_error
from remind_jax.plus.observation import Sightings
from remind_jax.plus.plane import squared_length
from remind_jax.plus.state import NO_RELATION, Pairs

GONE_ERROR = 1.5  # greatest standard deviation of an expected place, per size of the object


@dataclasses.dataclass(frozen=True)
class _Expectation:
    """Where each object should be, by the objects that are decided in this frame."""

    center: Float[Array, "O 2"]
    size: Float[Array, "O"]
    deviation: Float[Array, "O"]  # standard deviation of the center
    num_anchors: Int[Array, "O"]  # decided objects with a known relation


def find_gone(
    anchor: Int[Array, "N"],
    is_anchor: Bool[Array, "N"],
    sightings: Sightings,
    pairs: Pairs,
    t: th.Layout,
) -> Bool[Array, "O"]:
    """Objects whose place among the anchors is in view and empty.

    Args:
      anchor: Object of each detection that is decided.
      is_anchor: Detections that speak for their surroundings.
      sightings: Detections.
      pairs: What is known of every two objects.
      t: Errors of relations.
    """
    place = _expect(anchor, is_anchor, sightings, pairs, t)
    known = (place.num_anchors >= t.gone_anchors) & (place.deviation < GONE_ERROR * place.size)
    margin = (place.size / 2 + place.deviation)[:, None]
    far_corner = 2 * sightings.frame_center - margin
    inside = (place.center > margin) & (place.center < far_corner)
    in_view = inside[:, 0] & inside[:, 1]

    distance = jnp.sqrt(squared_length(place.center[:, None] - sightings.center[None]))
    # What is decided is itself, and hides only what it covers; what is open may be the object.
    covers = sightings.size[None] / 2
    reach = jnp.where(is_anchor[None], covers, covers + margin)
    is_empty = ~jnp.any(sightings.valid[None] & (distance < reach), axis=1)
    return known & in_view & is_empty


def _expect(
    anchor: Int[Array, "N"],
    is_anchor: Bool[Array, "N"],
    sightings: Sightings,
    pairs: Pairs,
    t: th.Layout,
) -> _Expectation:
    """The mean of what the anchors say, each by the precision of its relation."""
    p = jnp.where(is_anchor, anchor, 0)
    relation, spread = pairs.relation[:, p], pairs.spread[:, p]
    others = p[None] != jnp.arange(len(pairs.spread))[:, None]
    related = is_anchor[None] & (spread < NO_RELATION) & others
    log_ratio = jnp.where(related, pairs.log_ratio[:, p], 0.0)
    scale = sightings.size[None] * jnp.exp(log_ratio / 2)
    error = relation_error(relation, spread, sightings.touches[None], t) * scale
    weight = jnp.where(related, 1.0 / jnp.maximum(error, 1e-3) ** 2, 0.0)
    total = jnp.maximum(jnp.sum(weight, axis=1), 1e-9)
    share = weight / total[:, None]
    center = sightings.center[None] - relation * scale[..., None]
    log_size = jnp.log(jnp.maximum(sightings.size, 1e-3))[None] + log_ratio
    return _Expectation(
        center=jnp.sum(share[..., None] * center, axis=1),
        size=jnp.exp(jnp.sum(share * log_size, axis=1)),
        deviation=1.0 / jnp.sqrt(total),
        num_anchors=jnp.sum(related, axis=1),
    )
