"""Two that pass behind each other come out as they went in.

Rule: method_plus.md#crossing. Letters: `N` detections, `T` tracklets. Lengths in frame units.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from remind_jax.numerics.absent import NO_ID
from remind_jax.numerics.plane import area_of, common_box, middle_of, squared_length, turned
from remind_jax.numerics.ranks import largest
from remind_jax.plus.clock import tick_of
from remind_jax.plus.observation import Motion
from remind_jax.plus.own_movement import LEAST_MOVES
from remind_jax.plus.state import Tracklets

# Which of them meet.
LEAST_SHARED = 0.05  # share of the smaller box that lies in the other one
MARGIN = 0.5  # they stand apart again once their boxes, with so much of their size around, do
MOST_TICKS = 30.0  # ... or after this time
# How they go on.
PACE_SAMPLES = 6.0  # ticks that a pace averages
SIZE_ERROR = 0.15  # of a place, by what hides a part of it, share of the size
TICK_ERROR = 0.005  # more of it per tick, length ...
DOUBLING = 30.0  # ... and twice as much per tick after so many
TAILS = 3.0  # degrees of freedom: people also stop and turn


def carry_courses(tracklets: Tracklets, motion: Motion) -> Float[Array, "T 2"]:
    """Where each tracklet would be in this frame, had it gone on as before."""
    by_image = turned(tracklets.course, motion.matrix[:, :2]) + motion.matrix[:, 2]
    return by_image + tick_of(motion.elapsed) * tracklets.pace


def course_odds(tracklets: Tracklets, box: Float[Array, "N 4"]) -> Float[Array, "N T"]:
    """Log odds, 0 at most, of each tracklet that met another one, beside the one that fits best.

    By how far each box is from where the tracklet would be, had it gone on as before. Where all of
    them went another way, that speaks against none.

    Args:
      tracklets: Tracklets, carried to this frame.
    """
    met = tracklets.met
    error = SIZE_ERROR * tracklets.size + TICK_ERROR * met * (1.0 + met / DOUBLING)
    offset = middle_of(box)[:, None] - tracklets.course[None]
    odds = -0.5 * (TAILS + 2.0) * jnp.log1p(squared_length(offset) / (TAILS * error**2))
    best = jnp.max(jnp.where(met > 0, odds, -jnp.inf), axis=1, keepdims=True)
    return jnp.where(met > 0, odds - best, 0.0)


def follow_courses(
    tracklets: Tracklets, linked: Bool[Array, "N"], gap: Float[Array, "N"], tick: Float[Array, ""]
) -> Tracklets:
    """Tracklets with the course and pace that they had when they last stood apart.

    Two of one class meet when one of them is missed while the box of the other one covers it.

    Args:
      tracklets: Tracklets after this frame, those of its detections first; courses carried to it.
      gap: Ticks since that was seen.
    """
    num, box, met = len(linked), tracklets.box, tracklets.met
    here, waiting = (
        jax.tree.map(lambda leaf, part=part: leaf[part], tracklets)
        for part in (slice(num), slice(num, None))
    )
    shared = area_of(common_box(here.box[:, None], waiting.box))
    least = jnp.minimum(area_of(here.box)[:, None], area_of(waiting.box))
    shared = jnp.where(here.alive[:, None] & waiting.alive, shared / jnp.maximum(least, 1e-6), 0.0)
    shared = jnp.where(here.class_id[:, None] == waiting.class_id, shared, 0.0)
    share = jnp.concatenate([jnp.max(shared, axis=1), jnp.max(shared, axis=0)])
    hidden, hiding = waiting.id[largest(shared, 1)[1]], here.id[largest(shared, 0)[1]]
    is_old = jnp.pad(linked, (0, len(met) - num), constant_values=True)
    meets = (share > LEAST_SHARED) & ((met > 0) | (tracklets.num_moves >= LEAST_MOVES))
    met_id = jnp.where(meets, jnp.concatenate([hidden, hiding]), tracklets.met_id)
    # One that waits stays met as long as it waits.
    is_other = (here.met_id[:, None] == tracklets.id) & tracklets.alive
    around = box + MARGIN * tracklets.size[:, None] * jnp.array([-1.0, -1.0, 1.0, 1.0])
    other = around[largest(is_other)[1]]
    near = jnp.any(is_other, axis=1) & (area_of(common_box(around[:num], other)) > 0)
    stays = (met > 0) & jnp.pad(near, (0, len(met) - num), constant_values=True)
    is_met = tracklets.alive & is_old & (meets | stays) & (met < MOST_TICKS)
    since = jnp.maximum(gap, met[:num])  # ticks that its course went on by itself
    rate = tick / (since * jnp.clip(here.age - 1, 1, PACE_SAMPLES))
    rate = jnp.pad(jnp.where(linked, rate, 0.0), (0, len(met) - num))
    pace = tracklets.pace + rate[:, None] * (middle_of(box) - tracklets.course)
    pace = jnp.where(is_old[:, None], pace, 0.0)
    return dataclasses.replace(
        tracklets,
        met=jnp.where(is_met, met + tick, 0.0),
        met_id=jnp.where(is_met, met_id, NO_ID),
        course=jnp.where(is_met[:, None], tracklets.course, middle_of(box)),
        pace=jnp.where(is_met[:, None], tracklets.pace, pace),
    )
