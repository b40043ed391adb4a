"""Any exported image encoder as a backbone: `onnx:PATH`; the shapes of a probe say what is what."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.backbone.registry import Backbone
from remind_jax.detectors.onnx_model import MEAN, STD, OnnxModel, image_input, model_digest
from remind_jax.errors import ConfigError, WeightsError
from remind_jax.masks.letterbox import Letterbox

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
        """The patch grid of one image. Raises WeightsError if it has another shape."""
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
    mean: Sequence[float] = tuple(MEAN.tolist()),
    std: Sequence[float] = tuple(STD.tolist()),
) -> Backbone:
    """Makes a backbone from an encoder with one image input `[B, 3, H, W]`.

    Unlike other backbones, this one cannot be traced. An encoder of one input size gets frames of
    other sizes scaled into it, at the top left, and its tokens are resampled to patches of the
    frame (backbones.md#fixed-input).

    Args:
      path: `FILE`, or `FILE#OUTPUT`: which output holds the patches, or several of one grid with
        commas between, which are put side by side; the only one that may if left out.

    Raises:
      WeightsError: If the file is missing, damaged or no such encoder.
      ConfigError: If several outputs may be meant, or onnxruntime is not installed.
    """
    path, output = _split_target(path)
    model = OnnxModel(path)
    height, width = image_input(model.signature, "an image encoder").shape[2:]
    fixed_size = None if height is None or width is None else (height, width)
    shift, scale = np.array(mean, np.float32), np.array(std, np.float32)

    def run(image: UInt8[np.ndarray, "h w 3"]) -> dict[str, np.ndarray]:
        pixels = (image.astype(np.float32) * np.float32(1 / 255) - shift) / scale
        if fixed_size is not None:
            bars = [(0, whole - part) for whole, part in zip(fixed_size, image.shape, strict=False)]
            pixels = np.pad(pixels, [*bars, (0, 0)])
        return model(np.ascontiguousarray(pixels.transpose(2, 0, 1)[None]))

    size = fixed_size or _PROBE
    chosen = _find_patches(run(np.full((*size, 3), 127, np.uint8)), size, output, path)
    patch_px = chosen[0].patch_px

    def see(image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "Hp Wp D"]:
        """The grid over the whole input of the network."""
        grid = [side // patch_px for side in fixed_size or image.shape[:2]]
        outputs = run(image)
        parts = [patches.read(outputs[patches.name], *grid) for patches in chosen]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)

    def apply(images: UInt8[np.ndarray, "B H W 3"]) -> Float[jax.Array, "B Hp Wp D"]:
        images = np.asarray(images)
        if fixed_size in (None, images.shape[1:3]):
            return jnp.asarray(np.stack([see(image) for image in images]))
        inside = Letterbox.fit(images.shape[1:3], fixed_size).scaled_size
        tokens = np.stack([see(_scaled(image, inside, patch_px)) for image in images])
        return _to_frame(tokens, images.shape[1:3], inside, patch_px)

    digest = model_digest(Path(path))
    options = f"{','.join(patches.name for patches in chosen)}-{[*mean, *std]}"
    return Backbone(
        name=f"onnx-{Path(path).stem}-{digest[:12]}",
        patch_px=patch_px,
        dim=sum(patches.dim for patches in chosen),
        apply=apply,
        fingerprint=f"{digest}-{options}",
    )


def _split_target(path: str) -> tuple[str, str | None]:
    """File and output of `FILE#OUTPUT`; a file whose name holds a hash stays whole."""
    file, mark, named = path.rpartition("#")
    return (path, None) if not mark or Path(path).exists() else (file, named)


def _find_patches(
    outputs: dict[str, np.ndarray], size: tuple[int, int], wanted: str | None, path: str
) -> list[PatchOutput]:
    """The outputs that follow the image, patch by patch: those wanted, or the only one."""
    shapes = ", ".join(f"{name} {list(array.shape)}" for name, array in outputs.items())
    names = list(outputs) if wanted is None else wanted.split(",")
    for name in names:
        if name not in outputs:
            raise ConfigError(f"'{path}' has no output '{name}'; its outputs are {shapes}")
    seen = {name: recognize(name, outputs[name].shape, size) for name in names}
    found = [patches for patches in seen.values() if patches is not None]
    if not found or (wanted is not None and len(found) < len(seen)):
        what = "no output of" if wanted is None else f"not every one of the outputs '{wanted}' of"
        raise WeightsError(
            f"{what} '{path}' is a patch grid or token sequence for an image of "
            f"{size[1]}x{size[0]} pixels; its outputs are {shapes}; where patches are of a size "
            "that does not divide these, export it with a fixed input"
        )
    listed = ", ".join(f"'{patches.name}' ({patches.patch_px} pixels)" for patches in found)
    if wanted is None and len(found) > 1:
        raise ConfigError(
            f"'{path}' has several outputs of patches, {listed}; name one: 'onnx:{path}#"
            f"{found[0].name}'"
        )
    if len({patches.patch_px for patches in found}) > 1:
        raise ConfigError(
            f"outputs of '{path}' have patches of several sizes, {listed}; name such of one size"
        )
    return found


def _scaled(
    image: UInt8[np.ndarray, "h w 3"], size: tuple[int, int], patch_px: int
) -> UInt8[np.ndarray, "H W 3"]:
    """An image of another size, its border repeated until the last patches are full."""
    way = cv2.INTER_AREA if size[0] < image.shape[0] else cv2.INTER_LINEAR
    below, beside = (-side % patch_px for side in size)
    scaled = cv2.resize(image, size[::-1], interpolation=way)
    return cv2.copyMakeBorder(scaled, 0, below, 0, beside, cv2.BORDER_REPLICATE)


def _to_frame(
    tokens: Float[np.ndarray, "B Gh Gw D"],
    size: tuple[int, int],
    inside: tuple[int, int],
    patch_px: int,
) -> Float[jax.Array, "B Hp Wp D"]:
    """Features at the patches of a frame that was scaled (backbones.md#fixed-input)."""
    rows, columns = (-(-side // patch_px) for side in inside)
    factors = jnp.array([side / scaled for side, scaled in zip(size, inside, strict=True)])
    batch, _, _, dim = tokens.shape
    return jax.image.scale_and_translate(
        jnp.asarray(tokens[:, :rows, :columns]),
        (batch, size[0] // patch_px, size[1] // patch_px, dim),
        (1, 2),
        factors,
        jnp.zeros(2),
        method="linear",
        antialias=True,
    )


def recognize(name: str, shape: tuple[int, ...], size: tuple[int, int]) -> PatchOutput | None:
    """What an output of this shape is, for one image of this size; None if it holds no patches."""
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
