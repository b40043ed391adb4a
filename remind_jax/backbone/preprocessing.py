"""What published encoders expect of an image."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

# Of ImageNet, RGB after scaling to [0, 1]: what all three families were trained with.
MEAN = np.array([0.485, 0.456, 0.406], np.float32)
STD = np.array([0.229, 0.224, 0.225], np.float32)


def normalize(images: UInt8[Array, "... 3"]) -> Float[Array, "... 3"]:
    """RGB of 0 to 255 to zero mean and unit variance, operation by operation as published."""
    return (images.astype(jnp.float32) * np.float32(1 / 255) - MEAN) / STD
