"""Vision transformers as backbones: weights found and placed, compiled once per image size."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from remind_jax.backbone.registry import Backbone
from remind_jax.backbone.vit import Numerics, Tokens, arrange_params, encode
from remind_jax.backbone.vit_attention import Method, ObjectAttention
from remind_jax.backbone.vit_variants import CUSTOM, Variant
from remind_jax.backbone.vit_weights import DTYPES, Weights, load_weights
from remind_jax.backbone.weights_download import obtain_weights, was_fetched
from remind_jax.compiled.compiler_options import Kind, compiler_options
from remind_jax.compiled.programs import keep_function
from remind_jax.detectors.onnx_model import MEAN, STD
from remind_jax.errors import ConfigError, WeightsError

Precision = Literal["float32", "bfloat16"]

# Scores of all heads together, above which attention on a CPU is worked on in chunks.
_PLAIN_SCORES_MAX = 2_000_000


def normalize(images: UInt8[Array, "... 3"]) -> Float[Array, "... 3"]:
    """RGB of 0 to 255 to zero mean and unit variance, operation by operation as published."""
    return (images.astype(jnp.float32) * np.float32(1 / 255) - MEAN) / STD


def vit(
    name: str,
    weights: str | Path | None = None,
    *,
    precision: Precision = "float32",
) -> Backbone:
    """A published network.

    Args:
      precision: Of matrix products: `"float32"` is exact, `"bfloat16"` fast on GPUs and TPUs.

    Raises:
      WeightsError: If there are no weights, or they are of another network or damaged.
      ConfigError: If the precision is neither.
    """
    _check_precision(precision)
    path = obtain_weights(name, weights)
    try:
        loaded = load_weights(path, name)
    except WeightsError as error:
        if not was_fetched(name, path):
            raise
        raise WeightsError(f"{error}; or remove it, and it is fetched again") from error
    return _make(loaded, precision)


def vit_from_file(weights: str, *, precision: Precision = "float32") -> Backbone:
    """Whatever network a converted file holds, published or not; options as for `vit`."""
    _check_precision(precision)
    return _make(load_weights(weights), precision)


def choose_attention(variant: Variant, num_tokens: int, platform: str) -> Method:
    """The quickest way to attend, as measured by `benchmarks/vit.py`."""
    is_small = variant.heads * num_tokens**2 <= _PLAIN_SCORES_MAX
    return "plain" if platform != "cpu" or is_small else "chunked"


def _check_precision(precision: str) -> None:
    if precision not in DTYPES:
        raise ConfigError(f"precision is '{precision}'; allowed: {', '.join(DTYPES)}")


def _make(weights: Weights, precision: Precision) -> Backbone:
    variant = weights.variant
    is_custom = variant.name == CUSTOM
    name = f"vit-{weights.sha256[:12]}" if is_custom else variant.name
    known = variant if is_custom else variant.position  # a name says the rest
    run = functools.partial(_run, variant, precision)
    numerics = Numerics(DTYPES[precision])
    early = numerics.num_early(variant.depth) or ""
    params = jax.device_put(arrange_params(weights.params, variant, numerics))

    # The library that "network" leaves out is what uses a processor's instructions for bfloat16.
    kind: Kind = "network" if precision == "float32" else "plain"
    encode_patches = keep_function(
        "vit", lambda params, images: run(params, images).patches, (variant, precision), kind
    )

    @functools.partial(jax.jit, compiler_options=compiler_options(kind), static_argnames="heads")
    def attending(params: Any, images: Array, patches: Array, heads: tuple[int, ...] | None) -> Any:
        tokens = run(params, images, objects=patches, heads=heads)
        return tokens.patches, tokens.object_attention

    def apply_with_attention(
        images: UInt8[Array, "B H W 3"],
        patches: Int[Array, "B K"],
        heads: tuple[int, ...] | None = None,
    ) -> tuple[Float[Array, "B Hp Wp D"], ObjectAttention]:
        if heads is not None and (not heads or min(heads) < 0 or max(heads) >= variant.heads):
            raise ConfigError(
                f"attention heads {heads} were asked for; '{name}' has heads from 0 to "
                f"{variant.heads - 1}"
            )
        return attending(params, images, patches, heads)

    return Backbone(
        name=name,
        patch_px=variant.patch_px,
        dim=variant.width,
        apply=functools.partial(encode_patches, params),
        apply_with_attention=apply_with_attention,
        fingerprint=f"{weights.sha256}-{known}-{precision}{early}",
    )


def _run(
    variant: Variant,
    precision: Precision,
    params: Any,
    images: UInt8[Array, "B H W 3"],
    objects: Int[Array, "B K"] | None = None,
    heads: tuple[int, ...] | None = None,
) -> Tokens:
    """One forward pass; the way to attend is chosen by the image size, which is known here."""
    rows, columns = (side // variant.patch_px for side in images.shape[1:3])
    num_tokens = variant.num_prefix + rows * columns
    attention = choose_attention(variant, num_tokens, jax.default_backend())
    numerics = Numerics(DTYPES[precision], attention)
    return encode(params, normalize(images), variant, numerics, objects=objects, heads=heads)
