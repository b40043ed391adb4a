"""Several backbones as one: features of each patch side by side (backbones.md#joined).

Letters as in `registry`. The first decides the patches, the others see the frame scaled to them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.backbone.registry import Backbone
from remind_jax.numerics.pooling import to_unit


def combine(parts: Sequence[Backbone]) -> Backbone:
    """A backbone whose cosine of two patches is the mean of the parts' cosines.

    Features of each part are scaled to unit length first, so that none outweighs the others. It
    cannot be traced, and has no attention.
    """
    patch_px = parts[0].patch_px

    def apply(images: UInt8[np.ndarray, "B H W 3"]) -> Float[jax.Array, "B Hp Wp D"]:
        images = np.asarray(images)
        rows, columns = (side // patch_px for side in images.shape[1:3])
        features = []
        for part in parts:
            size = rows * part.patch_px, columns * part.patch_px
            found = part.extract(_scaled(images, size))
            features.append(to_unit(jnp.asarray(found)) / len(parts) ** 0.5)
        return jnp.concatenate(features, axis=-1)

    digest = hashlib.sha256()
    for part in parts:
        digest.update(f"{part.name}\0{part.fingerprint}\0".encode())
    return Backbone(
        name="+".join(part.name for part in parts),
        patch_px=patch_px,
        dim=sum(part.dim for part in parts),
        apply=apply,
        fingerprint=f"combined-{digest.hexdigest()}",
    )


def _scaled(
    images: UInt8[np.ndarray, "B H W 3"], size: tuple[int, int]
) -> UInt8[np.ndarray, "B H2 W2 3"]:
    """Images of another height and width."""
    if images.shape[1:3] == size:
        return images
    way = cv2.INTER_AREA if size[0] < images.shape[1] else cv2.INTER_LINEAR
    return np.stack([cv2.resize(image, size[::-1], interpolation=way) for image in images])
