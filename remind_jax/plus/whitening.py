"""Which differences of looks matter: scatter within tracklets against scatter of all.

Rule: method_plus.md#whitening.

What varies within a tracklet (light, view, blur) says little about identity. Looks are compared by
cosine after whitening with the scatter within tracklets, in the main directions of all looks.

Letters: `N` detections, `D` feature dimension, `E` compared directions.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
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
    valid = sightings.valid
    taught = jnp.stack([valid, sightings.has_ring, valid, linked])  # as the columns of weights
    counts = jnp.sum(taught, axis=1)
    fade = t.scatter_decay**counts
    # Running means forget beyond a number of samples, scatters with each.
    limited = jnp.minimum(scene.weights + counts, t.mean_samples)
    weights = jnp.where(np.arange(4) < 2, limited, scene.weights * fade + counts)
    rate = 1.0 / jnp.maximum(weights[:2, None], 1.0)
    off_mean = jnp.where(valid[:, None], sightings.look - scene.mean, 0.0)
    off_ring = jnp.where(sightings.has_ring[:, None], sightings.ring - scene.ring_mean, 0.0)
    step_of_means = jnp.stack([jnp.sum(off_mean, axis=0), jnp.sum(off_ring, axis=0)])
    means = scene.means + rate * step_of_means
    around = jnp.where(valid[:, None], sightings.look - means[0], 0.0)
    within = jnp.where(linked[:, None], step, 0.0)
    return dataclasses.replace(
        scene,
        means=means,
        weights=weights,
        total=scene.total * fade[2] + _scatter(around),
        within=scene.within * fade[3] + _scatter(within),
    )


def renew_whitening(
    scene: Scene, objects: Objects, frame: Int[Array, ""], t: th.Looks
) -> tuple[Scene, Objects]:
    """Every third frame: whitens anew, what is remembered included."""
    due = (frame < EAGER_FRAMES) | (frame % REFRESH_FRAMES == 0)
    due &= scene.total_weight > 0

    def renew() -> _Whitening:
        renewed = _refit(scene, t)
        white = jnp.where(objects.bank_count[..., None] > 0, whiten(renewed, objects.bank), 0.0)
        return _Whitening(renewed.basis, renewed.whitener, renewed.white_mean, white)

    # Only what is made anew goes through the branch: it would copy the rest.
    before = _Whitening(scene.basis, scene.whitener, scene.white_mean, objects.white_bank)
    now = branch(due, renew, lambda: before)
    return (
        dataclasses.replace(
            scene, basis=now.basis, whitener=now.whitener, white_mean=now.white_mean
        ),
        dataclasses.replace(objects, white_bank=now.white_bank),
    )


class _Whitening(NamedTuple):
    """What is renewed; fields as in `Scene` and `Objects`."""

    basis: Float[Array, "D E"]
    whitener: Float[Array, "E D"]
    white_mean: Float[Array, "D"]
    white_bank: Float[Array, "O K E"]


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
