"""Any exported image encoder as a backbone: `onnx:PATH`, run by onnxruntime on the CPU.

Shapes say what is what: the encoder is run once on a picture that is twice as wide as high,
and an output counts if it is a grid of patches, or a sequence of tokens that ends in one.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.backbone.preprocessing import MEAN, STD
from remind_jax.backbone.registry import Backbone
from remind_jax.detectors.onnx_file import OnnxFile, image_input
from remind_jax.detectors.onnx_session import OnnxSession
from remind_jax.errors import ConfigError, SourceError, WeightsError

# Divisible by all common patches: 7, 8, 14, 16, 28 and 32 pixels.
_PROBE = (224, 448)
_MAX_PREFIX = 16  # tokens before the patches: cls and registers
_MIN_PATCH_PX, _MAX_PATCH_PX = 4, 64


@dataclasses.dataclass(frozen=True)
class PatchOutput:
    """Where the patches are in an output."""

    name: str
    kind: str  # "channels first", "channels last" or "tokens"
    patch_px: int
    dim: int
    num_prefix: int = 0  # tokens before the patches

    def read(
        self, array: Float[np.ndarray, "1 ..."], rows: int, columns: int
    ) -> Float[np.ndarray, "Hp Wp D"]:
        """The patch grid of one image.

        Raises:
          WeightsError: If the output does not follow the image size as it did for the probe.
        """
        shapes = {
            "channels first": (1, self.dim, rows, columns),
            "channels last": (1, rows, columns, self.dim),
            "tokens": (1, self.num_prefix + rows * columns, self.dim),
        }
        if array.shape != shapes[self.kind]:
            raise WeightsError(
                f"output '{self.name}' has shape {list(array.shape)} instead of "
                f"{list(shapes[self.kind])} for {rows}x{columns} patches; export the encoder with "
                "open height and width"
            )
        grid = array[0]
        if self.kind == "channels first":
            return np.moveaxis(grid, 0, -1)
        if self.kind == "channels last":
            return grid
        return grid[self.num_prefix :].reshape(rows, columns, self.dim)


def onnx_encoder(
    path: str,
    *,
    output: str | None = None,
    mean: Sequence[float] = tuple(MEAN.tolist()),
    std: Sequence[float] = tuple(STD.tolist()),
    num_threads: int | None = None,
) -> Backbone:
    """Makes a backbone from an encoder with one image input `[B, 3, H, W]`.

    Unlike other backbones, this one cannot be traced.

    Args:
      path: The `.onnx` file.
      output: Which output holds the patches; the only one that may if left out.
      mean: Subtracted from RGB after scaling to [0, 1]; of ImageNet if left out.
      std: What is divided by then.
      num_threads: Threads of onnxruntime; its own choice if left out.

    Raises:
      WeightsError: If the file is missing, damaged or no such encoder.
      ConfigError: If several outputs may be meant, or onnxruntime is not installed.
    """
    file = OnnxFile.read(path)
    height, width = image_input(file, "an image encoder").shape[2:]
    fixed_size = None if height is None or width is None else (height, width)
    session = OnnxSession(file, "onnxruntime", num_threads)
    shift, scale = np.array(mean, np.float32), np.array(std, np.float32)

    def run(image: UInt8[np.ndarray, "H W 3"]) -> dict[str, np.ndarray]:
        pixels = (image.astype(np.float32) * np.float32(1 / 255) - shift) / scale
        return session(np.ascontiguousarray(pixels.transpose(2, 0, 1)[None]))

    size = fixed_size or _PROBE
    patches = _find_patches(run(np.full((*size, 3), 127, np.uint8)), size, output, path)

    def apply(images: UInt8[np.ndarray, "B H W 3"]) -> Float[jax.Array, "B Hp Wp D"]:
        height, width = images.shape[1:3]
        if fixed_size not in (None, (height, width)):
            raise SourceError(
                f"encoder '{path}' takes images of {fixed_size[1]}x{fixed_size[0]} pixels only, "
                f"the frame has {width}x{height}; export it with open height and width"
            )
        grid = height // patches.patch_px, width // patches.patch_px
        outputs = [run(image)[patches.name] for image in np.asarray(images)]
        return jnp.asarray(np.stack([patches.read(array, *grid) for array in outputs]))

    digest = hashlib.sha256(Path(path).read_bytes()).hexdigest()
    options = f"{patches.name}-{[*mean, *std]}"
    return Backbone(
        name=f"onnx-{Path(path).stem}-{digest[:12]}",
        patch_px=patches.patch_px,
        dim=patches.dim,
        apply=apply,
        fingerprint=f"{digest}-{options}",
    )


def _find_patches(
    outputs: dict[str, np.ndarray], size: tuple[int, int], wanted: str | None, path: str
) -> PatchOutput:
    """The output that follows the image, patch by patch."""
    shapes = ", ".join(f"{name} {list(array.shape)}" for name, array in outputs.items())
    if wanted is not None:
        if wanted not in outputs:
            raise ConfigError(f"'{path}' has no output '{wanted}'; its outputs are {shapes}")
        outputs = {wanted: outputs[wanted]}
    found = [
        patches
        for name, array in outputs.items()
        if (patches := recognize(name, array.shape, size)) is not None
    ]
    if not found:
        raise WeightsError(
            f"no output of '{path}' is a patch grid or token sequence for an image of "
            f"{size[1]}x{size[0]} pixels; its outputs are {shapes}"
        )
    if len(found) > 1:
        names = ", ".join(repr(patches.name) for patches in found)
        raise ConfigError(f"'{path}' has several outputs of patches ({names}); name one: output=")
    return found[0]


def recognize(name: str, shape: tuple[int, ...], size: tuple[int, int]) -> PatchOutput | None:
    """What an output of this shape is, for one image of this size; None if it holds no patches.

    Args:
      name: Of the output.
      shape: Of the output, the image axis included.
      size: Height and width of the image in pixels.
    """
    height, width = size
    sides = range(_MIN_PATCH_PX, min(_MAX_PATCH_PX, height, width) + 1)
    fitting = [s for s in sides if height % s == 0 and width % s == 0]
    if len(shape) == 4 and shape[0] == 1:
        for kind, grid, dim in (
            ("channels first", shape[2:], shape[1]),
            ("channels last", shape[1:3], shape[3]),
        ):
            for side in fitting:
                if grid == (height // side, width // side):
                    return PatchOutput(name, kind, side, dim)
    if len(shape) == 3 and shape[0] == 1:
        # The fewest tokens before the patches: finer grids differ by far more than a few tokens.
        for side in fitting:
            num_prefix = shape[1] - (height // side) * (width // side)
            if 0 <= num_prefix <= _MAX_PREFIX:
                return PatchOutput(name, "tokens", side, shape[2], num_prefix)
    return None
