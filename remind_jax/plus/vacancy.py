"""Empty places: an object that is not where it should be in view was moved, or taken away.

Rule: method_plus.md#empty-places.

Letters: `N` detections, `O` object slots. Lengths are in frame units.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.numerics.plane import squared_length
from remind_jax.plus import thresholds as th
from remind_jax.plus.evidence import relation_error
from remind_jax.plus.observation import Sightings
from remind_jax.plus.state import NO_RELATION, Pairs

GONE_ERROR = 1.5  # greatest standard deviation of an expected place, per size of the object


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
    """
    # Where each object should be: the mean of what the anchors say, by the precision of relations.
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
    places = sightings.center[None] - relation * scale[..., None]
    center = jnp.sum(share[..., None] * places, axis=1)
    log_sizes = jnp.log(jnp.maximum(sightings.size, 1e-3))[None] + log_ratio
    size = jnp.exp(jnp.sum(share * log_sizes, axis=1))
    deviation = 1.0 / jnp.sqrt(total)

    known = (jnp.sum(related, axis=1) >= t.gone_anchors) & (deviation < GONE_ERROR * size)
    margin = (size / 2 + deviation)[:, None]
    inside = (center > margin) & (center < 2 * sightings.frame_center - margin)
    in_view = inside[:, 0] & inside[:, 1]
    distance = jnp.sqrt(squared_length(center[:, None] - sightings.center[None]))
    # What is decided is itself, and hides only what it covers; what is open may be the object.
    covers = sightings.size[None] / 2
    reach = jnp.where(is_anchor[None], covers, covers + margin)
    is_empty = ~jnp.any(sightings.valid[None] & (distance < reach), axis=1)
    return known & in_view & is_empty
