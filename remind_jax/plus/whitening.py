"""Which differences of looks matter: scatter within tracklets against scatter of all.

Rule: method_plus.md#whitening.

What varies within a tracklet (light, view, blur) says little about identity. Looks are compared by
cosine after whitening with the scatter within tracklets, in the main directions of all looks. What
objects of a class have in common says little as well: looks are compared about the mean of their
class, as far as that stays where it is. The mean of a single object is that object, about which no
look is like another, so it counts as far as it is that of several.

Letters: `N` detections, `D` feature dimension, `E` compared directions, `F` frames from one renewal
to the next, `L` rows of classes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import count_up, fill_blocks
from remind_jax.numerics.pooling import to_unit
from remind_jax.plus import thresholds as th
from remind_jax.plus.class_names import name_row
from remind_jax.plus.observation import Sightings
from remind_jax.plus.own_movement import LEAVING, staying_of_class
from remind_jax.plus.small_matrices import diagonal, orthonormalize, root_of_inverse
from remind_jax.plus.state import SUMMED, Objects, Scene, Tracklets
from remind_jax.plus.static import LOOKS_BLOCK, NAME_ROWS, OBJECTS_BLOCK, REFRESH_FRAMES

EAGER_FRAMES = 5  # the whitening is renewed in each of the first frames
_TINY = 1e-9
RESOLUTION = 1e-4  # nearer to the mean of all looks, a direction is that of rounding
REST = 0.01  # of the mean variance: directions that vary less are not searched for
TEACHES = 16.0  # detections of an object that teach in full
MEAN_SAMPLES = 3000.0  # running means forget beyond this many
SCATTER_DECAY = 0.9995  # what each sample leaves of the scatter so far
# The assumed scatter within tracklets.
PRIOR_SAMPLES = 30.0  # that it counts for
PRIOR_SHARE = 0.1  # part of the total
PRIOR_ROUND = 0.7  # part of it that is equal in all directions
# What is added to the scatter within tracklets.
RIDGE = 0.1  # of its mean variance, in all directions
TOTAL_SHARE = 0.02  # share of the total scatter
LIGHT_SHARE = 0.1  # share of what light of another color changes
MEAN_PRIOR = 0.15  # squared objects beyond the first that the mean of all is believed half from
UNLIKE_COSINE = 0.7  # cosine of looks of two objects about no mean at all
CLASS_PRIOR = 3.0  # objects of a class beyond the first that its mean is believed half from
# Fields of `Scene` that are made anew when it is due.
_RENEWED = ("total", "within", "basis", "whitener", "white_mean", "raised", "class_offset")


def class_offset(scene: Scene, class_id: Int[Array, "*any"]) -> Float[Array, "*any D"]:
    """What looks of these classes are compared less, beside the mean of all."""
    return scene.class_offset[name_row(class_id)]


def whiten(scene: Scene, looks: Float[Array, "*any D"]) -> Float[Array, "*any E"]:
    """Looks as unit vectors whose inner products are compared; zeros for the mean of all."""
    centered = looks - scene.white_mean
    differs = jnp.sum(centered**2, axis=-1, keepdims=True) > RESOLUTION**2
    centered = jnp.where(differs, centered, 0.0)
    return to_unit(jnp.einsum("...d,ed->...e", centered, scene.whitener, precision="highest"))


def whiten_used(
    scene: Scene, looks: Float[Array, "X *any D"], used: Bool[Array, "X"]
) -> Float[Array, "X *any E"]:
    """`whiten` of the rows in use; zeros, most of them, in the others."""
    nothing = jnp.zeros((*looks.shape[:-1], len(scene.whitener)), looks.dtype)
    return fill_blocks(lambda rows_of: whiten(scene, rows_of(looks)), used, nothing, LOOKS_BLOCK)


def adjust_cosine(scene: Scene, cosine: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """Cosines of whitened looks, as they would be about the mean of many objects."""
    return jnp.maximum((cosine - scene.raised) / (1.0 - scene.raised), -1.0)


def share_of(here: Tracklets, objects: Objects) -> Float[Array, "N"]:
    """How much each detection teaches: the more its object was seen, the less.

    What stands still for a thousand frames would be all that the statistics know.
    """
    decided = here.slot != NO_SLOT
    seen = jnp.where(decided, objects.seen[jnp.maximum(here.slot, 0)], 0)
    known = jnp.maximum(jnp.maximum(seen, here.age), 1).astype(jnp.float32)
    return jnp.minimum(1.0, TEACHES / known)


def learn_scatter(
    scene: Scene,
    sightings: Sightings,
    step: Float[Array, "N D"],
    linked: Bool[Array, "N"],
    share: Float[Array, "N"],
    frame: Int[Array, ""],
    left: Float[Array, ""] | float = 1.0,
) -> Scene:
    """Takes the looks and backgrounds of a frame into the statistics.

    What the scatters are sums of is noted only: `renew_whitening` sums it up when it is due.

    Args:
      step: Look minus the smoothed look of its tracklet before.
      linked: Detections that continue a tracklet.
      share: How much each teaches (`share_of`).
      left: Share of the looks before that counts on (`scene_change.looks_left`).
    """
    of_look, of_ring, of_step = share * jnp.stack([sightings.valid, sightings.has_ring, linked])
    looks, rings, steps = jnp.sum(of_look), jnp.sum(of_ring), jnp.sum(of_step)
    # Running means forget beyond a number of samples, scatters with each.
    num_looks = jnp.minimum(left * scene.num_looks + looks, MEAN_SAMPLES)
    num_rings = jnp.minimum(left * scene.num_rings + rings, MEAN_SAMPLES)
    off_mean = _weighed(of_look, sightings.look - scene.mean)
    off_ring = _weighed(of_ring, sightings.ring - scene.ring_mean)
    mean = scene.mean + jnp.sum(off_mean, axis=0) / jnp.maximum(num_looks, _TINY)
    ring_mean = scene.ring_mean + jnp.sum(off_ring, axis=0) / jnp.maximum(num_rings, _TINY)
    # How classes differ from each other tells nothing about the objects of one.
    offset = class_offset(scene, sightings.class_id)
    around = _weighed(jnp.sqrt(of_look), sightings.look - mean - offset)
    within = _weighed(jnp.sqrt(of_step), step)
    looks_fade, steps_fade = left * SCATTER_DECAY**looks, SCATTER_DECAY**steps
    place = frame % REFRESH_FRAMES
    is_now = np.arange(REFRESH_FRAMES) == place
    return dataclasses.replace(
        scene,
        mean=mean,
        num_looks=num_looks,
        ring_mean=ring_mean,
        num_rings=num_rings,
        total_weight=scene.total_weight * looks_fade + looks,
        within_weight=scene.within_weight * steps_fade + steps,
        recent_looks=lax.dynamic_update_index_in_dim(scene.recent_looks, around, place, axis=0),
        looks_fade=jnp.where(is_now & (looks > 0), looks_fade, scene.looks_fade),
        recent_steps=lax.dynamic_update_index_in_dim(scene.recent_steps, within, place, axis=0),
        steps_fade=jnp.where(is_now & (steps > 0), steps_fade, scene.steps_fade),
    )


def _weighed(weight: Float[Array, "N"], values: Float[Array, "N D"]) -> Float[Array, "N D"]:
    """Values by their weights; those without any may be anything."""
    return jnp.where(weight[:, None] > 0, weight[:, None] * values, 0.0)


def renew_whitening(
    scene: Scene,
    objects: Objects,
    sightings: Sightings,
    frame: Int[Array, ""],
    t: th.PlusThresholds,
) -> tuple[Scene, Objects]:
    """Every third frame: sums up the scatters and whitens anew, what is remembered included."""
    believed = _believe_mean(objects, sightings)
    due = (frame < EAGER_FRAMES) | (frame % REFRESH_FRAMES == 0)
    due &= scene.total_weight > 0

    def renew(_: Array, before: tuple[Array, ...]) -> tuple[Array, ...]:
        total, within, white_bank = before[0], before[1], before[-1]
        total = sum_up(total, scene.recent_looks, scene.looks_fade)
        within = sum_up(within, scene.recent_steps, scene.steps_fade)
        renewed = dataclasses.replace(scene, total=total, within=within)
        renewed = _refit(renewed, sightings, believed, t.looks)
        renewed = dataclasses.replace(renewed, class_offset=_offset_classes(objects, renewed, t))

        def whiten_banks(rows_of: Callable[[Array], Array]) -> Float[Array, "B K E"]:
            offset = class_offset(renewed, rows_of(objects.class_id))[:, None]
            kept = rows_of(objects.bank_count)[..., None] > 0
            return jnp.where(kept, whiten(renewed, rows_of(objects.bank) - offset), 0.0)

        white_bank = fill_blocks(whiten_banks, objects.exists, white_bank, OBJECTS_BLOCK)
        return *(getattr(renewed, name) for name in _RENEWED), white_bank

    # Only what is made anew is handed on, and by a loop of one turn or none: a branch would copy
    # what stays, as would a turn that reads from `scene` what it is handed.
    before = *(getattr(scene, name) for name in _RENEWED), objects.white_bank
    *now, white_bank = count_up(due.astype(jnp.int32), renew, before)
    return (
        dataclasses.replace(
            scene,
            looks_fade=jnp.where(due, SUMMED, scene.looks_fade),
            steps_fade=jnp.where(due, SUMMED, scene.steps_fade),
            **dict(zip(_RENEWED, now, strict=True)),
        ),
        dataclasses.replace(objects, white_bank=white_bank),
    )


def _believe_mean(objects: Objects, sightings: Sightings) -> Float[Array, ""]:
    """How far the mean of all looks is that of objects in general, [0, 1)."""
    known = jnp.sum(objects.exists & jnp.any(objects.bank_count > 0, axis=1))
    others = jnp.maximum(jnp.maximum(known, jnp.sum(sightings.valid)) - 1.0, 0.0)
    return others**2 / (others**2 + MEAN_PRIOR)


def _refit(scene: Scene, sightings: Sightings, believed: Float[Array, ""], t: th.Looks) -> Scene:
    dim, directions = scene.basis.shape
    total = scene.total / jnp.maximum(scene.total_weight, 1.0)
    # As far as it is not that of several objects, they are assumed to differ in all directions.
    spread = (1.0 - UNLIKE_COSINE) * (jnp.sum(diagonal(total)) + jnp.sum(scene.mean**2)) / dim
    total = believed * total + (1.0 - believed) * spread * jnp.eye(dim, dtype=total.dtype)
    within = scene.within
    basis = scene.basis
    if directions < dim:
        # One step of orthogonal iteration at each renewal follows the main directions.
        # Directions that no look spans yet stay, or rounding would decide which they are.
        rest = REST * jnp.sum(diagonal(total)) / directions + _TINY
        basis = orthonormalize(total @ basis + rest * basis)
        total, within = basis.T @ total @ basis, basis.T @ within @ basis
    else:
        basis = jnp.eye(dim, dtype=total.dtype)
    identity = jnp.eye(directions, dtype=total.dtype)

    def mean_variance(scatter: Array) -> Array:
        return jnp.sum(diagonal(scatter)) / directions

    assumed = PRIOR_ROUND * mean_variance(total) * identity + (1.0 - PRIOR_ROUND) * total
    within = within + PRIOR_SAMPLES * PRIOR_SHARE * assumed
    # Light need not have changed yet to be another one when things come back.
    of_light = sightings.light_changes @ basis
    within = within / (scene.within_weight + PRIOR_SAMPLES) + LIGHT_SHARE * of_light.T @ of_light
    shaped = within + RIDGE * mean_variance(within) * identity + TOTAL_SHARE * total
    shaped = jnp.where(t.whitening, shaped, identity) + _TINY * identity
    # Any root of the inverse gives the same cosines.
    root = root_of_inverse(shaped).T
    # Of what is not positive there is none: all of it is NaN then.
    usable = jnp.all(jnp.isfinite(diagonal(root)))
    whitener = jnp.where(usable, root @ basis.T, scene.whitener)
    doubted = 1.0 - believed
    white_mean = jnp.where(sightings.is_background, scene.mean, believed * scene.mean)
    # Of looks with a cosine of UNLIKE_COSINE, what is left of their products and of their squares.
    raised = doubted**2 * UNLIKE_COSINE / (1.0 - UNLIKE_COSINE + doubted**2 * UNLIKE_COSINE)
    return dataclasses.replace(
        scene,
        basis=jnp.where(usable, basis, scene.basis),
        whitener=whitener,
        white_mean=jnp.where(usable, white_mean, scene.white_mean),
        raised=jnp.where(usable, raised, scene.raised),
    )


def _offset_classes(objects: Objects, scene: Scene, t: th.PlusThresholds) -> Float[Array, "L D"]:
    """By how much the mean of a class differs from that of all, the more objects it has the more.

    The looks of a single object say nothing about its class. The more a class moves, the less it
    is compared about its mean.
    """
    kept = objects.exists[:, None] & (objects.bank_count > 0)
    looks = jnp.sum(jnp.where(kept[..., None], objects.bank - scene.white_mean, 0.0), axis=1)
    looks = looks / jnp.maximum(jnp.sum(kept, axis=1), 1)[:, None]
    looks *= staying_of_class(objects.class_id, objects, t.mobility, LEAVING)[:, None]
    is_of_class = name_row(objects.class_id) == jnp.arange(NAME_ROWS)[:, None]
    is_of_class &= jnp.any(kept, axis=1)
    num = jnp.sum(is_of_class, axis=1, dtype=looks.dtype)[:, None]
    total = jnp.matmul(is_of_class.astype(looks.dtype), looks, precision="highest")
    others = jnp.maximum(num - 1.0, 0.0)
    return others / (others + CLASS_PRIOR) * total / jnp.maximum(num, 1.0)


def sum_up(
    scatter: Float[Array, "D D"], recent: Float[Array, "F N D"], fade: Float[Array, "F"]
) -> Float[Array, "D D"]:
    """The scatter with the frames that are not in it yet: each fades by those after it."""
    is_new = fade != SUMMED
    in_order = jnp.roll(jnp.where(is_new, fade, 1.0), -1)  # the frame of a renewal is the last one
    left = jnp.append(jnp.cumprod(in_order[:0:-1])[::-1], 1.0)
    weight = jnp.sqrt(jnp.where(is_new, jnp.roll(left, 1), 0.0))
    rows = (weight[:, None, None] * recent).reshape(-1, recent.shape[-1])
    return scatter * jnp.prod(in_order) + jnp.matmul(rows.T, rows, precision="highest")
