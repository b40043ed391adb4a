"""Does the image motion agree with what moved? An odometer that lies is found out.

Rule: method_plus.md#motion-check.

The estimated motion can be wrong with a good score: a big moving object, a repeated texture. It is
believed only as long as detections lie where it carries their tracklets. Otherwise the shift that
most of the look-alike pairs agree on takes its place, or none at all.

Letters: `N` detections, `T` tracklets. Lengths in frame units.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from remind_jax.numerics.plane import squared_length
from remind_jax.numerics.ranks import largest
from remind_jax.plus import thresholds as th
from remind_jax.plus.clock import tick_of
from remind_jax.plus.linking import Links, carry, score_links
from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.scene_map import DOUBTED_SCORE
from remind_jax.plus.state import Tracklets

CHECK_MARGIN = 0.5  # support per detection by which detections must contradict a motion
AGREEMENT = 0.3  # shifts of detections within this length agree
AGREEMENT_LEAST = 3.0  # detections that must agree on a shift
IMPLIED_SCORE = 0.25  # trust in a shift that they agree on


def check_motion(
    motion: Motion,
    tracklets: Tracklets,
    sightings: Sightings,
    cosine: Float[Array, "N T"],
    look_odds: Float[Array, "N T"],
    t: th.PlusThresholds,
) -> tuple[Motion, Links]:
    """The motion that is believed: the estimated one, the one that detections imply, or none.

    Also gives what it makes of the tracklets.

    Args:
      motion: Estimated from the image.
      tracklets: Tracklets where they were in the frame before.
      look_odds: Log odds that these are looks of one object.
    """
    still = dataclasses.replace(
        motion, matrix=jnp.eye(2, 3, dtype=jnp.float32), score=jnp.float32(0)
    )
    implied = dataclasses.replace(motion, **imply_motion(tracklets, sightings, cosine))

    def follow(hypothesis: Motion) -> Links:
        carried = carry(tracklets, hypothesis, t.mobility)
        return score_links(carried, sightings, cosine, look_odds, tick_of(motion.elapsed), t)

    def support(hypothesis: Motion) -> Float[Array, ""]:
        links = follow(hypothesis)
        excess = jnp.where(links.possible, links.score - t.linking.least, 0.0)
        return jnp.sum(jnp.max(excess, axis=1))

    believed = motion.score > DOUBTED_SCORE
    num = jnp.sum(sightings.valid).astype(jnp.float32)
    margin = jnp.where(believed, CHECK_MARGIN * num, 0.0)
    options = jax.tree.map(lambda *leaves: jnp.stack(leaves), motion, still, implied)
    supports = jax.vmap(support)(options) + jnp.stack([margin, 0.0, 0.0])
    best = jnp.where(t.motion.checked, largest(supports)[1], 0)
    chosen = jax.tree.map(lambda leaf: leaf[best], options)
    return chosen, follow(chosen)


def imply_motion(
    tracklets: Tracklets,
    sightings: Sightings,
    cosine: Float[Array, "N T"],
) -> dict[str, Array]:
    """The shift that most detections share with the tracklets that look most like them."""
    possible = sightings.valid[:, None] & (tracklets.alive & tracklets.just_seen)[None]
    possible &= sightings.class_id[:, None] == tracklets.class_id[None]
    likeness = jnp.where(possible, cosine, -jnp.inf)
    partner = largest(likeness)[1]
    paired = jnp.max(likeness, axis=1) > -jnp.inf
    shift = jnp.where(paired[:, None], sightings.center - tracklets.center[partner], 0.0)
    apart = squared_length(shift[:, None] - shift[None])
    agrees = (apart < AGREEMENT**2) & paired[None, :] & paired[:, None]
    votes = jnp.sum(agrees, axis=1)
    most = largest(votes)[1]
    chosen, num = agrees[most], votes[most].astype(jnp.float32)
    mean = jnp.sum(jnp.where(chosen[:, None], shift, 0.0), axis=0) / jnp.maximum(num, 1.0)
    enough = num >= AGREEMENT_LEAST
    matrix = jnp.concatenate(
        [jnp.eye(2, dtype=mean.dtype), jnp.where(enough, mean, 0.0)[:, None]], axis=1
    )
    return {"matrix": matrix, "score": jnp.where(enough, IMPLIED_SCORE, 0.0)}
