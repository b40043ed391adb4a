"""How every leaf of our weight files is made from published tensors (backbones.md#weight-files)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from remind_jax.backbone.vit_positions import rotary_periods
from remind_jax.backbone.vit_variants import Variant
from remind_jax.backbone.vit_weights import MAX_LISTED, leaf_shapes
from remind_jax.errors import WeightsError
from remind_jax.printing.words import first_of
from weights_convert.stored_tensors import StoredTensor

Shape = tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Recipe:
    """One leaf: which tensors it needs, of which shapes, and what is done with them."""

    leaf: str
    sources: tuple[tuple[str, Shape], ...]
    build: Callable[..., np.ndarray]  # from float32 arrays, in the order of the sources


def recipes(variant: Variant, tensors: Mapping[str, StoredTensor]) -> list[Recipe]:
    """How to make all leaves of a variant, in the order of `leaf_shapes`."""
    made = {recipe.leaf: recipe for recipe in _outer_recipes(variant, tensors)}
    for block in range(variant.depth):
        made |= {r.leaf: r for r in _block_recipes(variant, f"blocks.{block}.", tensors)}
    return [made[leaf] for leaf in leaf_shapes(variant)]


def _outer_recipes(v: Variant, tensors: Mapping[str, StoredTensor]) -> list[Recipe]:
    pixels = (v.width, 3, v.patch_px, v.patch_px)
    made = [
        Recipe("patch_embed.kernel", (("patch_embed.weight", pixels),), _flatten_convolution),
        _same("patch_embed.bias", "patch_embed.bias", (v.width,)),
        Recipe("cls_token", (("cls_token", (1, 1, v.width)),), _first),
        *_norm("norm", v.width),
    ]
    if v.registers:
        made.append(Recipe("registers", (("registers", (1, v.registers, v.width)),), _first))
    if v.cls_norm:
        made += _norm("cls_norm", v.width)
    if v.position != "rotary":
        shape = (1, 1 + v.table_side**2, v.width)
        made.append(Recipe("positions", (("positions", shape),), _first))
    elif "periods" in tensors:
        # Official files hold them rounded to bfloat16: they are part of the model.
        made.append(_same("periods", "periods", (v.head_width // 4,)))
    else:
        made.append(Recipe("periods", (), lambda: rotary_periods(v.head_width)))
    return made


def _block_recipes(v: Variant, block: str, tensors: Mapping[str, StoredTensor]) -> list[Recipe]:
    d, hidden = v.width, v.hidden
    made = [
        *_norm(f"{block}norm1", d),
        *_norm(f"{block}norm2", d),
        *_qkv(v, block, tensors),
        _matrix(f"{block}attention.proj.kernel", (f"{block}proj.weight", (d, d))),
        _same(f"{block}attention.proj.bias", f"{block}proj.bias", (d,)),
        _matrix(f"{block}mlp.down.kernel", (f"{block}down.weight", (d, hidden))),
        _same(f"{block}mlp.down.bias", f"{block}down.bias", (d,)),
    ]
    if v.layer_scale:
        made += [_same(f"{block}{name}", f"{block}{name}", (d,)) for name in ("scale1", "scale2")]
    if v.mlp == "gelu":
        sources, leaf = {"up": hidden}, "up"
    elif f"{block}gate_and_up.weight" in tensors:
        sources, leaf = {"gate_and_up": 2 * hidden}, "gate_and_up"
    else:
        sources, leaf = {"gate": hidden, "up": hidden}, "gate_and_up"
    weights = [(f"{block}{name}.weight", (num, d)) for name, num in sources.items()]
    biases = tuple((f"{block}{name}.bias", (num,)) for name, num in sources.items())
    made.append(_matrix(f"{block}mlp.{leaf}.kernel", *weights))
    made.append(Recipe(f"{block}mlp.{leaf}.bias", biases, _join))
    return made


def _qkv(v: Variant, block: str, tensors: Mapping[str, StoredTensor]) -> list[Recipe]:
    """The three projections, fused or separate; keys of DINOv3 lose their masked bias."""
    d = v.width
    biases = {"all": "qkv", "no key": "qv", "none": ""}[v.qkv_bias]
    leaf = f"{block}attention."
    if f"{block}qkv.weight" not in tensors and f"{block}q.weight" in tensors:
        parts = [(f"{block}{part}.weight", (d, d)) for part in "qkv"]
        return [
            _matrix(leaf + "qkv.kernel", *parts),
            *(_same(f"{leaf}{part}_bias", f"{block}{part}.bias", (d,)) for part in biases),
        ]
    sources = [(f"{block}qkv.bias", (3 * d,))]
    if v.qkv_bias == "no key" and f"{block}qkv.bias_mask" in tensors:
        sources.append((f"{block}qkv.bias_mask", (3 * d,)))
    return [
        _matrix(leaf + "qkv.kernel", (f"{block}qkv.weight", (3 * d, d))),
        *(
            Recipe(f"{leaf}{part}_bias", tuple(sources), _third("qkv".index(part)))
            for part in biases
        ),
    ]


def _same(leaf: str, name: str, shape: Shape) -> Recipe:
    return Recipe(leaf, ((name, shape),), lambda array: array)


def _norm(name: str, width: int) -> list[Recipe]:
    return [
        _same(f"{name}.scale", f"{name}.weight", (width,)),
        _same(f"{name}.bias", f"{name}.bias", (width,)),
    ]


def _matrix(leaf: str, *sources: tuple[str, Shape]) -> Recipe:
    return Recipe(leaf, sources, lambda *arrays: np.concatenate([a.T for a in arrays], axis=1))


def _join(*arrays: np.ndarray) -> np.ndarray:
    return np.concatenate(arrays)


def _first(array: np.ndarray) -> np.ndarray:
    return array[0]


def _flatten_convolution(weight: np.ndarray) -> np.ndarray:
    return weight.transpose(2, 3, 1, 0).reshape(-1, weight.shape[0])


def _third(index: int) -> Callable[..., np.ndarray]:
    """One of three equal parts, after a look at the mask of the key bias where there is one."""

    def take(bias: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
        if mask is not None and np.isfinite(mask).all():
            thirds = np.split(mask, 3)
            if not ((thirds[0] == 1).all() and (thirds[1] == 0).all() and (thirds[2] == 1).all()):
                raise WeightsError(
                    "the mask of the query, key and value bias is not 1, 0, 1 by thirds; no "
                    "published network has another"
                )
        return np.split(bias, 3)[index]

    return take


def check_complete(
    wanted: Sequence[Recipe],
    tensors: Mapping[str, StoredTensor],
    source_keys: Mapping[str, str],
    unexpected: Sequence[str],
    file: str,
    network: str,
) -> None:
    """Raises a `WeightsError` that tells of missing, unexpected and mis-shaped keys at once."""
    needed: dict[str, Shape] = {name: shape for r in wanted for name, shape in r.sources}
    faults: dict[str, list[str]] = {
        "missing": [name for name in needed if name not in tensors],
        "unexpected": [*unexpected, *(source_keys[n] for n in tensors if n not in needed)],
        "of another shape": [
            f"{source_keys[name]} {list(tensors[name].shape)} instead of {list(shape)}"
            for name, shape in needed.items()
            if name in tensors and tensors[name].shape != shape
        ],
    }
    found = [f"{kind}: {first_of(names, MAX_LISTED)}" for kind, names in faults.items() if names]
    if found:
        raise WeightsError(f"'{file}' does not hold exactly '{network}': {'; '.join(found)}")


def make_leaf(recipe: Recipe, tensors: Mapping[str, StoredTensor], file: str) -> Any:
    """The float32 array of a leaf. Raises WeightsError if it cannot be read or is not finite."""
    arrays = [np.asarray(tensors[name].read()) for name, _ in recipe.sources]
    if any(array.dtype.kind in "iub" for array in arrays):
        raise WeightsError(
            f"'{file}', '{recipe.leaf}': it holds whole numbers, whose scale is not known; give "
            "weights that are not quantized"
        )
    arrays = [array.astype(np.float32) for array in arrays]
    try:
        leaf = np.ascontiguousarray(recipe.build(*arrays), np.float32)
    except WeightsError as error:
        raise WeightsError(f"'{file}', '{recipe.leaf}': {error}") from error
    if not np.isfinite(leaf).all():
        raise WeightsError(
            f"'{file}' is damaged: '{recipe.leaf}' holds numbers that are not finite"
        )
    return leaf
