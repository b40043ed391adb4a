"""Where every object should be in the present frame, seen or not.

Rules: method_plus.md#map-motion, method_plus.md#place-correction.

Positions move along with the image. Their errors are shared, for the same image motion moves all of
them: one covariance per pair of objects, the same for x and y. Whoever is seen corrects the others.

Letters: `N` detections, `O` object slots. Lengths in frame units.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import count_up
from remind_jax.numerics.plane import medians, squared_length, turned, zoom_of
from remind_jax.plus import thresholds as th
from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.own_movement import forgetting_speed
from remind_jax.plus.small_matrices import diagonal
from remind_jax.plus.state import Objects, Pairs

MAX_AGE = 1000  # frames out of view; uncertainty grows no further
LEAST_VARIANCE = 1e-4
# Whether an image motion is believed, by its score.
DOUBTED_SCORE = 0.1  # not at all
TRUSTED_SCORE = 0.4  # fully from here on
# Standard deviations of what moves places, beyond `motion.shift_error`.
SHIFT_ERROR_RATE = 0.04  # of the shift per unit moved
SHIFT_ERROR_LOST = 0.25  # of the shift where the motion is not believed, length
TURN_ERROR = 0.004  # of turn and zoom per tick, radians
TURN_ERROR_LOST = 4.0  # factor above 1 where the motion is not believed
OWN_ERROR = 0.003  # of each object apart, per tick, length
OWN_ERROR_RATE = 0.006  # of each object apart, per unit moved
REACH = 30.0  # places further from the center turn as if they were this far, length
# Standard deviation of a measured center.
CENTER_ERROR = 0.06  # length
CENTER_ERROR_RATE = 0.15  # more of it per size of the mask
CENTER_ERROR_BORDER = 0.25  # more of it at the border of the frame, length
SURPRISE = 8.0  # median squared innovation above which the map was wrong, variances
BLOCK = 64  # detections whose turns are noted before the next ones read what is left


def doubt_of(motion: Motion) -> Float[Array, ""]:
    """How little an image motion is believed, [0, 1]."""
    trust = (motion.score - DOUBTED_SCORE) / (TRUSTED_SCORE - DOUBTED_SCORE)
    return 1.0 - jnp.clip(trust, 0.0, 1.0)


def shift_of(motion: Motion, frame_center: Float[Array, "2"]) -> Float[Array, ""]:
    """How far the image moved: its center."""
    moved = turned(frame_center, motion.matrix[:, :2]) + motion.matrix[:, 2] - frame_center
    return jnp.sqrt(squared_length(moved))


def move_map(
    objects: Objects,
    pairs: Pairs,
    motion: Motion,
    frame_center: Float[Array, "2"],
    frame: Int[Array, ""],
    tick: Float[Array, ""],
    t: th.Motion,
    mobile: th.Mobility,
) -> tuple[Objects, Pairs]:
    """Moves all positions along with the image and lets their errors grow.

    Positions turn with the image but do not zoom: out of view they would explode.
    """
    turn, shift = motion.matrix[:, :2], motion.matrix[:, 2]
    new_center = turned(frame_center, turn) + shift
    moved = shift_of(motion, frame_center)
    position = turned(objects.position - frame_center, turn / zoom_of(turn)) + new_center

    doubt = doubt_of(motion)
    # What errs at every frame adds up to the same in a tick, however many frames it has.
    part = jnp.sqrt(tick)
    rate = moved / tick
    shift_error = part * (t.shift_error + SHIFT_ERROR_RATE * rate) + SHIFT_ERROR_LOST * doubt
    shift_variance = shift_error**2
    turn_variance = (TURN_ERROR * (part + TURN_ERROR_LOST * doubt)) ** 2
    own_error = part * (OWN_ERROR + OWN_ERROR_RATE * rate + forgetting_speed(objects, mobile))
    age = tick * jnp.clip(frame - 1 - objects.last, 0, MAX_AGE)
    arm = jnp.clip(position - frame_center, -REACH, REACH)
    # The lesser age makes shared errors grow like a bias and keeps the covariance positive.
    shared_age = 1.0 + jnp.minimum(age[:, None], age[None, :])
    arms = arm[:, None, 0] * arm[None, :, 0] + arm[:, None, 1] * arm[None, :, 1]
    shared = (shift_variance + turn_variance * arms) * shared_age
    own = own_error**2 * (1.0 + age)
    itself = jnp.eye(len(age), dtype=bool)
    covariance = pairs.covariance + shared + jnp.where(itself, own[:, None], 0.0)
    both = objects.exists[:, None] & objects.exists[None, :]
    return (
        dataclasses.replace(objects, position=position),
        dataclasses.replace(pairs, covariance=jnp.where(both, covariance, 0.0)),
    )


def center_variance(size: Float[Array, "N"], touches: Bool[Array, "N"]) -> Float[Array, "N"]:
    """Variance of measured centers."""
    error = CENTER_ERROR + CENTER_ERROR_RATE * size
    return (error + CENTER_ERROR_BORDER * touches) ** 2


def correct_map(
    objects: Objects,
    pairs: Pairs,
    slot: Int[Array, "N"],
    sure: Bool[Array, "N"],
    surprising: Bool[Array, "N"],
    sightings: Sightings,
) -> tuple[Objects, Pairs]:
    """Kalman update of all positions by the objects in view.

    Args:
      slot: Object of each detection.
      sure: Detections whose object is decided.
      surprising: Those that may say that the map was wrong: objects with a place from before.
    """
    covariance = pairs.covariance
    place = jnp.where(sure, slot, 0)
    measured = center_variance(sightings.size, sightings.touches)
    own = diagonal(covariance)[place] + measured
    squared = squared_length(sightings.center - objects.position[place])
    # An unexpected step of most objects at once is an error of the image motion, shared by all.
    step, normalized = medians(jnp.stack([squared, squared / own]), surprising)
    added = jnp.where(normalized > SURPRISE, step, 0.0)
    exists = objects.exists[:, None] & objects.exists[None, :]
    covariance = jnp.where(exists, covariance + added, 0.0)

    noted = _take_turns(objects.position, covariance, place, sure, measured, sightings.center)
    taken = jnp.matmul(noted.gain.T, noted.shared, precision="highest")
    covariance = jnp.where(exists, _bound(covariance - taken, noted.own), 0.0)
    return (
        dataclasses.replace(objects, position=noted.position),
        dataclasses.replace(pairs, covariance=covariance),
    )


class _Turns(NamedTuple):
    """What the detections so far corrected."""

    position: Float[Array, "O 2"]
    own: Float[Array, "O"]  # variances of the positions
    gain: Float[Array, "N O"]  # how far each moved each position by its own error
    shared: Float[Array, "N O"]  # covariance of its object with all at its turn


def _take_turns(
    position: Float[Array, "O 2"],
    covariance: Float[Array, "O O"],
    place: Int[Array, "N"],
    sure: Bool[Array, "N"],
    measured: Float[Array, "N"],
    center: Float[Array, "N 2"],
) -> _Turns:
    """One detection after the other: the same as all at once, and no matrix to invert.

    A turn reads one row of the covariance, so turns only note what they take from it. Of many
    detections, one block after the other reads what those before have left of its rows.
    """
    num, num_o = len(place), len(position)
    own = jnp.maximum(diagonal(covariance), LEAST_VARIANCE)
    if num <= BLOCK:
        seen = place, sure, measured, center
        return _take_block(position, own, covariance[place], seen)
    blocks = -(-num // BLOCK)

    def in_blocks(leaf: Array) -> Array:
        padded = jnp.pad(leaf, ((0, blocks * BLOCK - num),) + ((0, 0),) * (leaf.ndim - 1))
        return padded.reshape(blocks, BLOCK, *leaf.shape[1:])

    seen = jax.tree.map(in_blocks, (place, sure, measured, center))

    def take(b: Array, before: _Turns) -> _Turns:
        of_block = jax.tree.map(lambda leaf: leaf[b], seen)
        at = of_block[0]
        taken = jnp.matmul(before.gain[:, at].T, before.shared, precision="highest")
        now = _take_block(before.position, before.own, covariance[at] - taken, of_block)

        def put(noted: Array, block: Array) -> Array:
            return lax.dynamic_update_slice_in_dim(noted, block, b * BLOCK, 0)

        return _Turns(
            now.position, now.own, put(before.gain, now.gain), put(before.shared, now.shared)
        )

    nothing = jnp.zeros((blocks * BLOCK, num_o), covariance.dtype)
    return lax.fori_loop(0, blocks, take, _Turns(position, own, nothing, nothing))


def _take_block(
    position: Float[Array, "O 2"],
    own: Float[Array, "O"],
    rows: Float[Array, "B O"],
    seen: tuple[Int[Array, "B"], Bool[Array, "B"], Float[Array, "B"], Float[Array, "B 2"]],
) -> _Turns:
    """The turns of some detections, from the rows of the covariance before the first of them."""
    place, sure, measured, center = seen
    index = jnp.arange(len(own))

    def correct(k: Array, turns: _Turns) -> _Turns:
        at = place[k]
        shared = rows[k] - jnp.matmul(turns.gain[:, at], turns.shared, precision="highest")
        shared = jnp.where(index == at, turns.own, _clip(shared, turns.own, turns.own[at]))
        gain = jnp.where(sure[k], shared / (turns.own[at] + measured[k]), 0.0)
        error = center[k] - turns.position[at]
        return _Turns(
            turns.position + gain[:, None] * error,
            jnp.maximum(turns.own - gain * shared, LEAST_VARIANCE),
            lax.dynamic_update_index_in_dim(turns.gain, gain, k, 0),
            lax.dynamic_update_index_in_dim(turns.shared, shared, k, 0),
        )

    nothing = jnp.zeros_like(rows)
    last = jnp.max(jnp.where(sure, jnp.arange(len(place)) + 1, 0))  # the others correct nothing
    return count_up(last, correct, _Turns(position, own, nothing, nothing), suits_all=True)


def _clip(
    covariance: Float[Array, "*any"], left: Float[Array, "*#any"], right: Float[Array, "*#any"]
) -> Float[Array, "*any"]:
    """Keeps correlations within one, which rounding would break; of two variances."""
    limit = jnp.sqrt(left) * jnp.sqrt(right)
    return jnp.clip(covariance, -limit, limit)


def _bound(covariance: Float[Array, "O O"], own: Float[Array, "O"]) -> Float[Array, "O O"]:
    """A covariance with these variances and correlations within one."""
    bounded = _clip(covariance, own[:, None], own[None, :])
    return jnp.where(jnp.eye(len(own), dtype=bool), own[:, None], bounded)
