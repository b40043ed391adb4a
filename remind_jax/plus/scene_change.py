"""Another scene comes into view: what was learned of looks elsewhere counts less.

Rule: method_plus.md#scene-change. Letters: `N` detections, `D` feature dimension.
"""

from __future__ import annotations

import dataclasses
import functools

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from remind_jax.numerics.control_flow import branch
from remind_jax.plus.observation import Sightings
from remind_jax.plus.small_matrices import diagonal
from remind_jax.plus.state import Scene
from remind_jax.plus.whitening import class_offset

SAMPLES_LEFT = 10.0  # that the past counts for in another scene
# Looks are strange by their squared distances from the mean, beside those of looks so far.
STRANGE_FROM, STRANGE_TO = 1.0, 2.0


def is_another(
    begins: Bool[Array, "N"], valid: Bool[Array, "N"], doubt: Float[Array, ""]
) -> Float[Array, ""]:
    """How surely another scene is in view, [0, 1]: the motion is unknown, hardly anything goes on.

    Args:
      begins: Detections that begin tracklets.
      valid: Detections.
      doubt: How little the estimated motion of the image is believed.
    """
    share = jnp.sum(begins, dtype=doubt.dtype) / jnp.maximum(jnp.sum(valid), 1)
    return jnp.maximum(2.0 * doubt * share - 1.0, 0.0)


def looks_left(
    scene: Scene, sightings: Sightings, begins: Bool[Array, "N"], another: Float[Array, ""]
) -> Float[Array, ""]:
    """Share of what was learned of looks that counts on, the less the stranger looks are now."""
    product = functools.partial(jnp.matmul, precision="highest")

    def strangeness() -> Float[Array, ""]:
        total = scene.total / jnp.maximum(scene.total_weight, 1.0)
        spread = jnp.sum(diagonal(product(product(scene.whitener, total), scene.whitener.T)))
        off = sightings.look - scene.mean - class_offset(scene, sightings.class_id)
        off = jnp.where(begins[:, None], off, 0.0)
        off = product(off, scene.whitener.T)
        distance = jnp.sum(off**2) / jnp.maximum(jnp.sum(begins), 1)
        ratio = distance / jnp.maximum(spread, 1e-9)
        return jnp.clip((ratio - STRANGE_FROM) / (STRANGE_TO - STRANGE_FROM), 0.0, 1.0)

    strange = branch(another > 0.0, strangeness, lambda: jnp.zeros_like(another))
    return _left(scene.total_weight, another * strange)


def fade_cosines(scene: Scene, another: Float[Array, ""]) -> Scene:
    """The scene, whose cosines count less where another one is in view."""
    of_all = _left(scene.cosine_weight, another)
    of_class = _left(scene.class_cosines[0], another)
    return dataclasses.replace(
        scene,
        cosine_weight=scene.cosine_weight * of_all,
        cosine_sum=scene.cosine_sum * of_all,
        cosine_squares=scene.cosine_squares * of_all,
        class_cosines=scene.class_cosines * of_class,
    )


def _left(weight: Float[Array, "*any"], another: Float[Array, ""]) -> Float[Array, "*any"]:
    """Share of so many samples that counts on."""
    return 1.0 - another * (1.0 - SAMPLES_LEFT / jnp.maximum(weight, SAMPLES_LEFT))
