"""DINOv3, DINOv2 and DINO v1 vision transformers in Flax, one module for all of them.

Written from a description of the networks (backbones.md#vit-forward). Float32 mode follows
the published models operation by operation: exact GELU, two-pass variance, rotations and softmax in
float32. Bfloat16 mode rounds what enters matrix products, with three exceptions: queries and keys,
the patch embedding, and the first quarter of the blocks. Every block changes a short stream more
than a long one, so what is lost at the start grows most, and what is lost later hardly at all.

Letters: `B` images, `N` tokens (cls, registers, patches in raster order), `D` features, `H` heads,
`E` features per head, `Hp Wp` patch grid.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from remind_jax.backbone.vit_attention import Method, ObjectAttention, attend, attention_among
from remind_jax.backbone.vit_positions import resample_table, rotary_tables, rotate
from remind_jax.backbone.vit_variants import Variant
from remind_jax.numerics.pytree import pytree

Rotation = tuple[Float[Array, "P E"], Float[Array, "P E"]]


# Of the depth, from the first block on, whose products are not rounded to bfloat16.
_EARLY_SHARE = 0.25


@dataclasses.dataclass(frozen=True)
class Numerics:
    """How a network is computed; changes results by rounding only."""

    dtype: Any = jnp.float32  # of what enters matrix products, early blocks excepted
    attention: Method = "plain"
    early: bool = False  # about the blocks before which nothing may be rounded

    @property
    def product_dtype(self) -> Any:
        """Of what enters the matrix products of weights, and attention weights and values."""
        return jnp.float32 if self.early else self.dtype

    @property
    def precision(self) -> jax.lax.Precision:
        """Of products of float32: full, or in bfloat16 mode TF32 on GPUs, three passes on TPUs."""
        exact = self.dtype == jnp.float32
        return jax.lax.Precision.HIGHEST if exact else jax.lax.Precision.HIGH

    def num_early(self, depth: int) -> int:
        """How many blocks of a network come before the first rounded one."""
        return 0 if self.dtype == jnp.float32 else math.ceil(_EARLY_SHARE * depth)

    def for_early(self) -> Numerics:
        """How these blocks and the patch embedding are computed."""
        return dataclasses.replace(self, early=True)


@pytree
class Tokens:
    """What a transformer says about patches, after its final norm."""

    patches: Float[Array, "B Hp Wp D"]
    object_attention: ObjectAttention | None  # where object patches were given


class Linear(nn.Module):
    """Matrix product with bias; accumulates in float32."""

    features: int
    numerics: Numerics
    use_bias: bool = True
    out_dtype: Any = None  # that of what is multiplied if left out

    @nn.compact
    def __call__(self, x: Float[Array, "... I"]) -> Float[Array, "... O"]:
        """Applies the layer to the last axis."""
        kernel = self.param("kernel", nn.initializers.lecun_normal(), (x.shape[-1], self.features))
        dtype = self.numerics.product_dtype
        y = jax.lax.dot_general(
            x.astype(dtype),
            kernel.astype(dtype),
            (((x.ndim - 1,), (0,)), ((), ())),
            precision=self.numerics.precision if dtype == jnp.float32 else None,
            preferred_element_type=jnp.float32,
        )
        if self.use_bias:
            y = y + self.param("bias", nn.initializers.zeros, (self.features,))
        return y.astype(self.out_dtype or dtype)


class Attention(nn.Module):
    """Self-attention; patches of DINOv3 are rotated by where they are."""

    variant: Variant
    numerics: Numerics
    heads: tuple[int, ...] | None  # over which attention of objects is averaged; all if None

    @nn.compact
    def __call__(
        self,
        x: Float[Array, "B N D"],
        rotation: Rotation | None,
        objects: Int[Array, "B K"] | None,
    ) -> tuple[Array, ObjectAttention | None]:
        """Returns mixed tokens, and the attention among patches of objects where they are given."""
        v, num = self.variant, self.numerics
        wide = functools.partial(Linear, numerics=num, out_dtype=jnp.float32)
        fused = wide(3 * v.width, use_bias=False, name="qkv")(x)
        heads = (*x.shape[:2], v.heads, v.head_width)
        q, k, values = (
            jnp.swapaxes(part.reshape(heads), 1, 2)
            for part in jnp.split(self._with_bias(fused), 3, axis=-1)
        )
        if rotation is not None:
            q, k = (_rotate_patches(t, rotation, v.num_prefix) for t in (q, k))
        q, values = q * v.head_width**-0.5, values.astype(num.product_dtype)
        mixed = attend(q, k, values, num.attention, num.precision)
        mixed = jnp.swapaxes(mixed, 1, 2).reshape(x.shape)

        among = None
        if objects is not None:
            among = attention_among(q, k, objects, v.num_prefix, self.heads, num.precision)
        return wide(v.width, name="proj")(mixed), among

    def _with_bias(self, fused: Float[Array, "B N E"]) -> Float[Array, "B N E"]:
        """Keys of DINOv3 have no bias: a common shift of rotated keys would not cancel."""
        kind, width = self.variant.qkv_bias, self.variant.width
        if kind == "none":
            return fused
        q_bias, v_bias = (
            self.param(name, nn.initializers.zeros, (width,)) for name in ("q_bias", "v_bias")
        )
        k_bias = jnp.zeros_like(q_bias)
        if kind == "all":
            k_bias = self.param("k_bias", nn.initializers.zeros, (width,))
        return fused + jnp.concatenate([q_bias, k_bias, v_bias])


def _rotate_patches(
    tokens: Float[Array, "B H N E"], rotation: Rotation, num_prefix: int
) -> Float[Array, "B H N E"]:
    prefix, patches = tokens[:, :, :num_prefix], tokens[:, :, num_prefix:]
    return jnp.concatenate([prefix, rotate(patches, *rotation)], axis=2)


class FeedForward(nn.Module):
    """The two layers after attention, with exact GELU or gated by SiLU."""

    variant: Variant
    numerics: Numerics

    @nn.compact
    def __call__(self, x: Float[Array, "B N D"]) -> Float[Array, "B N D"]:
        """Applies the layers to every token."""
        v, num = self.variant, self.numerics
        if v.mlp == "gelu":
            inner = Linear(v.hidden, num, name="up")(x).astype(jnp.float32)
            inner = _gelu(inner)
        else:
            fused = Linear(2 * v.hidden, num, name="gate_and_up")(x).astype(jnp.float32)
            gate, up = jnp.split(fused, 2, axis=-1)
            inner = jax.nn.silu(gate) * up
        return Linear(v.width, num, out_dtype=jnp.float32, name="down")(inner)


class Block(nn.Module):
    """One layer: attention, then feed-forward, each added to the stream."""

    variant: Variant
    numerics: Numerics
    heads: tuple[int, ...] | None

    @nn.compact
    def __call__(
        self,
        carry: tuple[Float[Array, "B N D"], ObjectAttention | None],
        rotation: Rotation | None,
        objects: Int[Array, "B K"] | None,
    ) -> tuple[tuple[Array, ObjectAttention | None], None]:
        """Returns the new stream and the attention summed so far."""
        stream, seen = carry
        v, num = self.variant, self.numerics
        attention = Attention(v, num, self.heads, name="attention")
        mixed, among = attention(_norm(v, "norm1")(stream), rotation, objects)
        stream = stream + self._scaled("scale1", mixed)
        inner = FeedForward(v, num, name="mlp")(_norm(v, "norm2")(stream))
        stream = stream + self._scaled("scale2", inner)
        if seen is not None:
            seen = jax.tree.map(jnp.add, seen, among)
        return (stream, seen), None

    def _scaled(self, name: str, x: Array) -> Array:
        if not self.variant.layer_scale:
            return x
        return x * self.param(name, nn.initializers.ones, (self.variant.width,))


class VisionTransformer(nn.Module):
    """A whole network; weights come from `vit_weights.load_weights`."""

    variant: Variant
    numerics: Numerics = Numerics()

    @nn.compact
    def __call__(
        self,
        images: Float[Array, "B H W 3"],
        *,
        objects: Int[Array, "B K"] | None = None,
        heads: tuple[int, ...] | None = None,
    ) -> Tokens:
        """Describes normalized images; what does not fill a patch is left out.

        Args:
          objects: Raster numbers of patches whose attention is wanted, `NO_PATCH` in unused slots.
        """
        v = self.variant
        stream, grid = self._embed(images)
        rotation = None
        if v.position == "rotary":
            periods = self.param("periods", nn.initializers.ones, (v.head_width // 4,))
            rotation = rotary_tables(*grid, periods)
        seen = None if objects is None else ObjectAttention.zeros(*objects.shape)
        for name, length, numerics in self._stacks():
            scan: Any = nn.scan  # its annotation knows no broadcast
            blocks = scan(
                Block,
                variable_axes={"params": 0},
                split_rngs={"params": True},
                in_axes=nn.broadcast,
                length=length,
            )
            run_blocks = blocks(v, numerics, heads, name=name)
            (stream, seen), _ = run_blocks((stream, seen), rotation, objects)
        if seen is not None:
            seen = jax.tree.map(lambda total: total / v.depth, seen)
        patches = _norm(v, "norm")(stream[:, v.num_prefix :])
        return Tokens(patches.reshape(len(patches), *grid, v.width), seen)

    def _stacks(self) -> list[tuple[str, int, Numerics]]:
        """Name, number and numerics of the blocks that are scanned together."""
        num = self.numerics
        early = num.num_early(self.variant.depth)
        stacks = [("early_blocks", early, num.for_early())]
        stacks.append(("blocks", self.variant.depth - early, num))
        return [stack for stack in stacks if stack[1]]

    def _embed(self, images: Array) -> tuple[Float[Array, "B N D"], tuple[int, int]]:
        """Tokens before the first block, and the patch grid."""
        v, num_images = self.variant, len(images)
        rows, columns = (side // v.patch_px for side in images.shape[1:3])
        patches = images[:, : rows * v.patch_px, : columns * v.patch_px]
        patches = patches.reshape(num_images, rows, v.patch_px, columns, v.patch_px, 3)
        patches = patches.transpose(0, 1, 3, 2, 4, 5).reshape(num_images, rows * columns, -1)
        patches = Linear(v.width, self.numerics.for_early(), name="patch_embed")(patches)

        cls = self.param("cls_token", nn.initializers.normal(0.02), (1, v.width))
        if v.table_side:
            shape = (1 + v.table_side**2, v.width)
            table = self.param("positions", nn.initializers.normal(0.02), shape)
            assert v.position != "rotary"
            places = table[1:].reshape(v.table_side, v.table_side, v.width)
            places = resample_table(places, rows, columns, v.position)
            cls, patches = cls + table[:1], patches + places.reshape(-1, v.width)
        prefix = [cls]
        if v.registers:
            shape = (v.registers, v.width)
            prefix.append(self.param("registers", nn.initializers.normal(0.02), shape))
        prefix = jnp.broadcast_to(jnp.concatenate(prefix), (num_images, v.num_prefix, v.width))
        return jnp.concatenate([prefix, patches], axis=1), (rows, columns)


def encode(
    params: Any,
    images: Float[Array, "B H W 3"],
    variant: Variant,
    numerics: Numerics | None = None,
    **wanted: Any,
) -> Tokens:
    """Describes normalized images: a pure function of weights and images."""
    numerics = numerics or Numerics()
    params = arrange_params(params, variant, numerics)
    tokens = VisionTransformer(variant, numerics).apply({"params": params}, images, **wanted)
    assert isinstance(tokens, Tokens)
    return tokens


def arrange_params(params: Any, variant: Variant, numerics: Numerics) -> Any:
    """Early blocks apart from the others, and every matrix in the type that it is multiplied in.

    Done once where weights are placed, it spares each image the work and the device memory.
    """
    early = numerics.num_early(variant.depth)
    if early and "early_blocks" not in params:
        blocks = params["blocks"]
        params = params | {"early_blocks": jax.tree.map(lambda leaf: leaf[:early], blocks)}
        params["blocks"] = jax.tree.map(lambda leaf: leaf[early:], blocks)
        if early == variant.depth:
            del params["blocks"]

    def cast(path: Any, leaf: Any) -> Any:
        is_rounded = path[0].key == "blocks" and path[-1].key == "kernel"
        dtype = numerics.dtype if is_rounded else jnp.float32
        return leaf if leaf.dtype == dtype else leaf.astype(dtype)

    return jax.tree_util.tree_map_with_path(cast, params)


def _gelu(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Exact GELU as published; JAX's own goes by `erfc`, which takes longer."""
    return 0.5 * x * (1 + jax.lax.erf(x * np.float32(0.5**0.5)))


def _norm(variant: Variant, name: str) -> nn.LayerNorm:
    """Layer norm in float32 with the variance of centered values, as published."""
    return nn.LayerNorm(
        epsilon=variant.norm_eps, dtype=jnp.float32, use_fast_variance=False, name=name
    )
