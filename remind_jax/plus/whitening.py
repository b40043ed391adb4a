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
from remind_jax.plus.small_matrices import diagonal, invert, orthonormalize
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
    looks: Float[Array, "N D"],
    valid: Bool[Array, "N"],
    step: Float[Array, "N D"],
    linked: Bool[Array, "N"],
    t: th.Looks,
) -> Scene:
    """Takes the looks of a frame into the statistics.

    Args:
      scene: Statistics so far.
      looks: Looks of the detections.
      valid: Detections.
      step: Look minus the smoothed look of its tracklet before.
      linked: Detections that continue a tracklet.
      t: Memory lengths.
    """
    num, num_linked = jnp.sum(valid), jnp.sum(linked)
    mean, num_looks = _run_mean(scene.mean, scene.num_looks, looks, valid, t.mean_samples)
    around = jnp.where(valid[:, None], looks - mean, 0.0)
    within = jnp.where(linked[:, None], step, 0.0)
    fade, fade_linked = t.scatter_decay**num, t.scatter_decay**num_linked
    return dataclasses.replace(
        scene,
        mean=mean,
        num_looks=num_looks,
        total=scene.total * fade + _scatter(around),
        total_weight=scene.total_weight * fade + num,
        within=scene.within * fade_linked + _scatter(within),
        within_weight=scene.within_weight * fade_linked + num_linked,
    )


def learn_rings(
    scene: Scene, rings: Float[Array, "N D"], valid: Bool[Array, "N"], t: th.Looks
) -> Scene:
    """Takes the backgrounds of a frame into their mean."""
    mean, num = _run_mean(scene.ring_mean, scene.num_rings, rings, valid, t.mean_samples)
    return dataclasses.replace(scene, ring_mean=mean, num_rings=num)


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
    root = jnp.linalg.cholesky(invert(shaped)).T
    # Of what is not positive there is none: all of it is NaN then.
    usable = jnp.all(jnp.isfinite(diagonal(root)))
    whitener = jnp.where(usable, root @ basis.T, scene.whitener)
    return dataclasses.replace(
        scene,
        basis=jnp.where(usable, basis, scene.basis),
        whitener=whitener,
        white_mean=jnp.where(usable, scene.mean, scene.white_mean),
    )


def _run_mean(
    mean: Float[Array, "D"],
    num: Float[Array, ""],
    values: Float[Array, "N D"],
    valid: Bool[Array, "N"],
    longest: Float[Array, ""],
) -> tuple[Float[Array, "D"], Float[Array, ""]]:
    """Running mean that forgets beyond a number of samples."""
    num = jnp.minimum(num + jnp.sum(valid), longest)
    step = jnp.sum(jnp.where(valid[:, None], values - mean, 0.0), axis=0)
    return mean + step / jnp.maximum(num, 1.0), num


def _scatter(vectors: Float[Array, "N D"]) -> Float[Array, "D D"]:
    return jnp.matmul(vectors.T, vectors, precision="highest")
