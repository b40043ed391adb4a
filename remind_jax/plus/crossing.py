"""Two that pass behind each other come out as they went in.

Rule: method_plus.md#crossing. Letters: `N` detections, `T` tracklets. Lengths in frame units.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from remind_jax.numerics.absent import NO_ID
from remind_jax.plus.own_movement import LEAST_MOVES
from remind_jax.plus.plane import area_of, middle_of, shared_area, squared_length
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


def course_odds(tracklets: Tracklets, box: Float[Array, "N 4"]) -> Float[Array, "N T"]:
    """Log odds, 0 at most, of each tracklet that met another one, beside the one that fits best.

    By how far each box is from where the tracklet would be, had it gone on as before. Where all of
    them went another way, that speaks against none.

    Args:
      tracklets: Tracklets, carried to this frame.
      box: Boxes of detections.
    """
    met = tracklets.met
    error = SIZE_ERROR * tracklets.size + TICK_ERROR * met * (1.0 + met / DOUBLING)
    offset = middle_of(box)[:, None] - tracklets.course[None]
    odds = -0.5 * (TAILS + 2.0) * jnp.log1p(squared_length(offset) / (TAILS * error**2))
    best = jnp.max(jnp.where(met > 0, odds, -jnp.inf), axis=1, keepdims=True)
    return jnp.where(met > 0, odds - best, 0.0)


def follow_courses(
    tracklets: Tracklets,
    is_old: Bool[Array, "T"],
    is_seen: Bool[Array, "T"],
    gap: Float[Array, "T"],
    tick: Float[Array, ""],
) -> Tracklets:
    """Tracklets with the course and pace that they had when they last stood apart.

    Two of one class meet when one of them is missed while the box of the other one covers it.

    Args:
      tracklets: Tracklets after this frame, their courses carried to it.
      is_old: Those that were there before.
      is_seen: Those of them that are in this frame.
      gap: Ticks since each was last seen.
      tick: Time since the last frame, one tick at most.
    """
    box, met, waits = tracklets.box, tracklets.met, tracklets.unseen > 0
    alike = tracklets.class_id[:, None] == tracklets.class_id
    alike &= tracklets.alive[:, None] & tracklets.alive & ~jnp.eye(len(met), dtype=bool)
    area = area_of(box)
    shared = shared_area(box, box) / jnp.maximum(jnp.minimum(area[:, None], area), 1e-6)
    hides = alike & (waits[:, None] | waits) & (shared > LEAST_SHARED)
    meets = jnp.any(hides, axis=1) & is_old & ((met > 0) | (tracklets.num_moves >= LEAST_MOVES))
    around = MARGIN * tracklets.size[:, None] * jnp.array([-1.0, -1.0, 1.0, 1.0])
    near = alike & (shared_area(box + around, box + around) > 0)
    is_near = jnp.any(near & (tracklets.met_id[:, None] == tracklets.id), axis=1)
    is_met = (meets | ((met > 0) & is_old & is_near)) & (met < MOST_TICKS)
    other = jnp.argmax(jnp.where(hides, shared, -1.0), axis=1)
    met_id = jnp.where(meets, tracklets.id[other], tracklets.met_id)
    rate = jnp.where(is_seen, tick / (gap * jnp.clip(tracklets.age - 1, 1, PACE_SAMPLES)), 0.0)
    pace = tracklets.pace + rate[:, None] * (middle_of(box) - tracklets.course)
    pace = jnp.where(is_old[:, None], pace, 0.0)
    return dataclasses.replace(
        tracklets,
        met=jnp.where(is_met, met + tick, 0.0),
        met_id=jnp.where(is_met, met_id, NO_ID),
        course=jnp.where(is_met[:, None], tracklets.course, middle_of(box)),
        pace=jnp.where(is_met[:, None], tracklets.pace, pace),
    )
