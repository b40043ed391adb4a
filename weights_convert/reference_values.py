"""First output values that publishers and ports have printed, to check converted weights against.

Image: COCO val2017 000000039769 (two cats), scaled to [0, 1], resized to 224x224 by bilinear
interpolation with antialiasing, ImageNet statistics (backbones.md#reference-values).
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from remind_jax.backbone.vit_weights import load_weights
from remind_jax.errors import SourceError

IMAGE_NAME = "COCO val2017 000000039769"
SIDE_PX = 224
# Hugging Face checks its port of the same weights to this: its rotary periods are not rounded.
TOLERANCE = 1e-3


@dataclasses.dataclass(frozen=True)
class Published:
    """The first five features of cls and of the first patch."""

    weights: str  # what the network was trained on
    cls: tuple[float, ...]
    patch: tuple[float, ...]


# By name of variant; cls, then patch.
# fmt: off
PUBLISHED: dict[str, tuple[Published, ...]] = {
    "dinov3-vits16": (
        Published("LVD-1689M", (0.463561, -0.415609, 0.408236, -0.126613, -0.286636),
                  (-0.038754, -0.250895, -0.016392, -0.455473, 0.571582)),
    ),
    "dinov3-vits16plus": (
        Published("LVD-1689M", (-0.471349, -1.365778, -0.317983, 0.377219, -0.769085),
                  (0.144551, -0.388117, -0.393433, -0.157695, -0.60038)),
    ),
    "dinov3-vitb16": (
        Published("LVD-1689M", (1.034643, -0.180609, -0.341018, -0.066376, -0.011383),
                  (-0.082523, -0.456272, -0.728029, -0.43068, -0.15288)),
    ),
    "dinov3-vitl16": (
        Published("LVD-1689M", (0.484527, -0.582214, 0.480636, 0.59204, 0.945166),
                  (-0.211367, -0.490863, -0.257131, 0.101763, 0.154511)),
        Published("SAT-493M", (-0.33235, 0.34052, -0.22087, 0.21434, 0.09003),
                  (0.18488, 0.30309, -0.20689, 0.12848, 0.06207)),
    ),
    "dinov3-vith16plus": (
        Published("LVD-1689M", (-0.064575, -0.148866, -0.621524, 0.634878, 0.152695),
                  (-0.093817, 0.287407, -0.050036, 0.428043, 0.094561)),
    ),
    "dinov3-vit7b16": (
        Published("LVD-1689M", (0.275439, -0.261353, 0.067772, 0.049936, -0.158747),
                  (0.044442, -0.052542, 0.070777, -0.065111, -0.026546)),
        Published("SAT-493M", (-0.19779, 0.11819, -0.00581, -0.21055, -0.03971),
                  (-0.12423, 0.07879, -0.10057, 0.02835, -0.11727)),
    ),
}
# fmt: on


@dataclasses.dataclass(frozen=True)
class Check:
    """First values of converted weights beside published ones."""

    variant: str
    cls: tuple[float, ...]
    patch: tuple[float, ...]
    nearest: Published | None  # None: nothing is known of this network
    difference: float | None  # largest

    @property
    def agrees(self) -> bool:
        """Whether the values are those that were published."""
        return self.difference is not None and self.difference <= TOLERANCE


def check_values(weights: str | Path, image: str | Path) -> Check:
    """Runs a converted network on an image and compares its first values.

    Raises:
      WeightsError: If the weights cannot be read.
      SourceError: If the image cannot be read.
    """
    import jax

    from remind_jax.backbone.preprocessing import MEAN, STD
    from remind_jax.backbone.vit import encode

    loaded = load_weights(weights)
    side = SIDE_PX - SIDE_PX % loaded.variant.patch_px
    pixels = _read_image(image).astype(np.float32) / 255
    resized = jax.image.resize(pixels, (side, side, 3), "linear", antialias=True)
    params = jax.tree.map(lambda leaf: leaf.astype(np.float32), loaded.params)
    tokens = encode(params, ((resized - MEAN) / STD)[None], loaded.variant)
    cls, patch = (tuple(map(float, t[:5])) for t in (tokens.cls[0], tokens.patches[0, 0, 0]))
    candidates = PUBLISHED.get(loaded.variant.name, ())
    distances = [
        float(np.abs(np.array(cls + patch) - np.array(known.cls + known.patch)).max())
        for known in candidates
    ]
    if not candidates:
        return Check(loaded.variant.name, cls, patch, None, None)
    best = int(np.argmin(distances))
    return Check(loaded.variant.name, cls, patch, candidates[best], distances[best])


def _read_image(path: str | Path) -> np.ndarray:
    import cv2

    try:
        data = np.frombuffer(Path(path).read_bytes(), np.uint8)
    except OSError as error:
        raise SourceError(f"image '{path}' cannot be read: {error.strerror}") from error
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    if image is None:
        raise SourceError(f"'{path}' is no image that can be read")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
