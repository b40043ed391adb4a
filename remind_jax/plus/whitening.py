"""Which differences of looks matter: scatter within tracklets against scatter of all.

Rule: method_plus.md#whitening.

What varies within a tracklet (light, view, blur) says little about identity. Looks are compared by
cosine after whitening with the scatter within tracklets, in the main directions of all looks.

Letters: `N` detections, `D` feature dimension, `E` compared directions.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pooling import to_unit
from remind_jax.plus import thresholds as th
from remind_jax.plus.observation import Sightings
from remind_jax.plus.small_matrices import diagonal, orthonormalize, root_of_inverse
from remind_jax.plus.state import Objects, Scene

REFRESH_FRAMES = 3  # the whitening is renewed every so many frames
EAGER_FRAMES = 5  # and in each of the first ones
_TINY = 1e-9


def whiten(scene: Scene, looks: Float[Array, "*any D"]) -> Float[Array, "*any E"]:
    """Looks as unit vectors whose inner products are compared."""
    centered = looks - scene.white_mean
    return to_unit(jnp.einsum("...d,ed->...e", centered, scene.whitener, precision="highest"))


def learn_scatter(
    scene: Scene,
    sightings: Sightings,
    step: Float[Array, "N D"],
    linked: Bool[Array, "N"],
    t: th.Looks,
) -> Scene:
    """Takes the looks and backgrounds of a frame into the statistics.

    Args:
      scene: Statistics so far.
      sightings: Detections.
      step: Look minus the smoothed look of its tracklet before.
      linked: Detections that continue a tracklet.
      t: Memory lengths.
    """
    valid, has_ring = sightings.valid, sightings.has_ring
    counts = jnp.sum(jnp.stack([valid, has_ring, linked]), axis=1)
    # Running means forget beyond a number of samples.
    num = jnp.minimum(jnp.stack([scene.num_looks, scene.num_rings]) + counts[:2], t.mean_samples)
    rate = 1.0 / jnp.maximum(num, 1.0)
    off_mean = jnp.where(valid[:, None], sightings.look - scene.mean, 0.0)
    off_ring = jnp.where(has_ring[:, None], sightings.ring - scene.ring_mean, 0.0)
    mean = scene.mean + rate[0] * jnp.sum(off_mean, axis=0)
    around = jnp.where(valid[:, None], sightings.look - mean, 0.0)
    within = jnp.where(linked[:, None], step, 0.0)
    fade = t.scatter_decay**counts
    return dataclasses.replace(
        scene,
        mean=mean,
        num_looks=num[0],
        ring_mean=scene.ring_mean + rate[1] * jnp.sum(off_ring, axis=0),
        num_rings=num[1],
        total=scene.total * fade[0] + _scatter(around),
        total_weight=scene.total_weight * fade[0] + counts[0],
        within=scene.within * fade[2] + _scatter(within),
        within_weight=scene.within_weight * fade[2] + counts[2],
    )


def renew_whitening(
    scene: Scene, objects: Objects, frame: Int[Array, ""], t: th.Looks
) -> tuple[Scene, Objects]:
    """Every third frame: whitens anew, what is remembered included."""
    due = (frame < EAGER_FRAMES) | (frame % REFRESH_FRAMES == 0)
    due &= scene.total_weight > 0

    def renew() -> tuple[Scene, Objects]:
        renewed = _refit(scene, t)
        white = jnp.where(objects.bank_count[..., None] > 0, whiten(renewed, objects.bank), 0.0)
        return renewed, dataclasses.replace(objects, white_bank=white)

    return branch(due, renew, lambda: (scene, objects))


def _refit(scene: Scene, t: th.Looks) -> Scene:
    dim, directions = scene.basis.shape
    total = scene.total / jnp.maximum(scene.total_weight, 1.0)
    within = scene.within
    basis = scene.basis
    if directions < dim:
        # One step of orthogonal iteration at each renewal follows the main directions.
        basis = orthonormalize(total @ basis + _TINY * basis)
        total, within = basis.T @ total @ basis, basis.T @ within @ basis
    else:
        basis = jnp.eye(dim, dtype=total.dtype)
    identity = jnp.eye(directions, dtype=total.dtype)

    def mean_variance(scatter: Array) -> Array:
        return jnp.sum(diagonal(scatter)) / directions

    assumed = t.prior_round * mean_variance(total) * identity + (1.0 - t.prior_round) * total
    within = within + t.prior_samples * t.prior_share * assumed
    within = within / (scene.within_weight + t.prior_samples)
    shaped = within + t.ridge * mean_variance(within) * identity + t.total_share * total
    shaped = jnp.where(t.whitening, shaped, identity) + _TINY * identity
    # Any root of the inverse gives the same cosines.
    root = root_of_inverse(shaped).T
    # Of what is not positive there is none: all of it is NaN then.
    usable = jnp.all(jnp.isfinite(diagonal(root)))
    whitener = jnp.where(usable, root @ basis.T, scene.whitener)
    return dataclasses.replace(
        scene,
        basis=jnp.where(usable, basis, scene.basis),
        whitener=whitener,
        white_mean=jnp.where(usable, scene.mean, scene.white_mean),
    )


def _scatter(vectors: Float[Array, "N D"]) -> Float[Array, "D D"]:
    return jnp.matmul(vectors.T, vectors, precision="highest")
