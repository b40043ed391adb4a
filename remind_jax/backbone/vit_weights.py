"""Weight files of vision transformers: one safetensors file per network, matrices as `[in, out]`.

A file with any leaf missing, left over or of another shape is refused.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import ml_dtypes
import numpy as np
from safetensors import safe_open

from remind_jax.backbone.vit_variants import CUSTOM, TERMS, VARIANTS, Variant, name_of
from remind_jax.errors import RemindError, WeightsError
from remind_jax.files import reading, say_no_file, user_cache_folder
from remind_jax.files.records import decode_json
from remind_jax.files.tensors import read_safetensors_header
from remind_jax.printing.words import first_of

FORMAT = "remind-jax vision transformer"
SCHEMA_VERSION = "1"
WEIGHTS_VARIABLE = "REMIND_WEIGHTS"
DTYPES: dict[str, np.dtype] = {
    "float32": np.dtype(np.float32),
    "bfloat16": np.dtype(ml_dtypes.bfloat16),
}
_STACKED = "blocks."  # leaves of all blocks become one array [L, ...]
MAX_LISTED = 6  # leaves that a message names


@dataclasses.dataclass(frozen=True)
class Weights:
    """One network as read from a file."""

    variant: Variant
    params: dict[str, Any]  # tree of arrays for `vit.VisionTransformer`, host memory
    sha256: str  # of the tensor bytes; names the weights wherever features are kept


def leaf_shapes(variant: Variant) -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor in the file of a variant."""
    v = variant
    leaves: dict[str, tuple[int, ...]] = {
        "patch_embed.kernel": (v.patch_px * v.patch_px * 3, v.width),  # y, x, channel
        "patch_embed.bias": (v.width,),
        "cls_token": (1, v.width),
        "norm.scale": (v.width,),
        "norm.bias": (v.width,),
    }
    if v.registers:
        leaves["registers"] = (v.registers, v.width)
    if v.position == "rotary":
        leaves["periods"] = (v.head_width // 4,)
    else:
        leaves["positions"] = (1 + v.table_side**2, v.width)
    if v.cls_norm:
        leaves |= {"cls_norm.scale": (v.width,), "cls_norm.bias": (v.width,)}
    for block in range(v.depth):
        leaves |= {f"blocks.{block}.{leaf}": shape for leaf, shape in _block_shapes(v).items()}
    return leaves


def _block_shapes(v: Variant) -> dict[str, tuple[int, ...]]:
    up, num_up = ("gate_and_up", 2 * v.hidden) if v.mlp == "swiglu" else ("up", v.hidden)
    shapes: dict[str, tuple[int, ...]] = {
        "attention.qkv.kernel": (v.width, 3 * v.width),
        "attention.proj.kernel": (v.width, v.width),
        "attention.proj.bias": (v.width,),
        f"mlp.{up}.kernel": (v.width, num_up),
        f"mlp.{up}.bias": (num_up,),
        "mlp.down.kernel": (v.hidden, v.width),
        "mlp.down.bias": (v.width,),
    }
    biases = {"all": "qkv", "no key": "qv", "none": ""}[v.qkv_bias]
    shapes |= {f"attention.{part}_bias": (v.width,) for part in biases}
    shapes |= {f"norm{i}.{leaf}": (v.width,) for i in (1, 2) for leaf in ("scale", "bias")}
    if v.layer_scale:
        shapes |= {"scale1": (v.width,), "scale2": (v.width,)}
    return shapes


def look_for_weights(name: str, given: str | Path | None = None) -> tuple[Path | None, list[Path]]:
    """The weights of a named variant, None if there are none, and where they were looked for.

    Args:
      given: A file, or a folder with `NAME.safetensors`. Left out: the file or folder that the
        environment variable `REMIND_WEIGHTS` names, then the user's cache folder.
    """
    tried: list[Path] = []
    for place in (given, os.environ.get(WEIGHTS_VARIABLE), default_folder()):
        if not place:
            continue
        path = Path(place)
        path = path / f"{name}.safetensors" if path.is_dir() else path
        if path.is_file():
            return path, tried
        tried.append(path)
        if place == given:
            break
    return None, tried


def find_weights(name: str, given: str | Path | None) -> Path:
    """`look_for_weights`; if there are none, raises a WeightsError that says where to get them."""
    found, tried = look_for_weights(name, given)
    if found is not None:
        return found
    terms = TERMS[VARIANTS[name].family]
    places = " or ".join(f"'{path}'" for path in tried)
    raise WeightsError(
        f"there are no weights for '{name}' at {places}: {terms.source}; they are "
        f"under the {terms.license} ({terms.license_url}); convert them once with 'remind convert "
        f"SOURCE --variant {name} -o {default_folder() / f'{name}.safetensors'}', or name the "
        f"converted file by weights (--weights PATH) or the environment variable {WEIGHTS_VARIABLE}"
    )


def default_folder() -> Path:
    """Where weights are looked for if nothing else is said."""
    return user_cache_folder() / "weights"


def load_weights(path: str | Path, expected: str | None = None) -> Weights:
    """Reads a converted weight file. Raises WeightsError if it is not whole, or not `expected`."""
    path = Path(path)
    if wrong := say_no_file(path):
        raise WeightsError(f"weight file '{path}' {wrong}; give a file that 'remind convert' wrote")
    if zipfile.is_zipfile(path):  # as PyTorch saves
        raise _not_ours(path)
    said = read_safetensors_header(path, refused=WeightsError)
    header = said.metadata
    variant = _variant_in(header, path, expected)
    _check_leaves(said.shapes, variant, path)
    _check_bytes(path, header)
    with reading(path, WeightsError), safe_open(path, framework="np") as file:
        params = _gather(file, list(said.shapes), DTYPES[header["dtype"]], path)
    return Weights(variant, params, header["data_sha256"])


def _not_ours(path: Path) -> WeightsError:
    return WeightsError(
        f"'{path}' was not written by remind-jax; bring it to its layout first: "
        f"remind convert '{path}' -o weights.safetensors"
    )


def _variant_in(header: Mapping[str, str], path: Path, expected: str | None) -> Variant:
    """The architecture that a header describes."""
    if header.get("format") != FORMAT:
        raise _not_ours(path)
    if header.get("schema") != SCHEMA_VERSION:
        raise WeightsError(
            f"'{path}' has schema {header.get('schema')}, this version reads {SCHEMA_VERSION}; "
            "convert it again with 'remind convert'"
        )
    try:
        said = header["architecture"].encode()
        variant = decode_json(said, Variant, "`architecture`", refused=WeightsError)
        variant.check()
        is_whole = header["dtype"] in DTYPES and bool(header["data_sha256"])
    except (KeyError, RemindError) as error:
        raise WeightsError(f"the header of '{path}' is damaged: {error}") from error
    if not is_whole:
        raise WeightsError(f"the header of '{path}' is damaged: dtype {header['dtype']!r}")
    if variant.name not in (CUSTOM, name_of(variant)):  # what looks published may be another's
        raise WeightsError(
            f"'{path}' calls itself '{variant.name}' but describes '{name_of(variant)}'; convert "
            "it again with 'remind convert'"
        )
    if expected is not None and variant.name != expected:
        raise WeightsError(
            f"'{path}' holds '{variant.name}', not '{expected}'; ask for "
            + (f"backbone '{variant.name}'" if variant.name != CUSTOM else f"'vit:{path}'")
        )
    return variant


def _check_leaves(shapes: Mapping[str, tuple[int, ...]], variant: Variant, path: Path) -> None:
    """Raises a `WeightsError` unless a file holds exactly what its variant needs."""
    needed = leaf_shapes(variant)
    faults = {
        "missing": sorted(set(needed) - set(shapes)),
        "left over": sorted(set(shapes) - set(needed)),
        "of another shape": sorted(
            name for name in set(needed) & set(shapes) if needed[name] != shapes[name]
        ),
    }
    found = [f"{kind}: {first_of(names, MAX_LISTED)}" for kind, names in faults.items() if names]
    if found:
        raise WeightsError(
            f"'{path}' does not hold the weights of '{variant.name}' ({'; '.join(found)}); convert "
            "it again with 'remind convert'"
        )


def _check_bytes(path: Path, header: Mapping[str, str]) -> None:
    """Raises a `WeightsError` if tensor bytes are not those that were written."""
    with path.open("rb") as file:
        file.seek(8 + int.from_bytes(file.read(8), "little"))
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if found != header["data_sha256"]:
        raise WeightsError(
            f"tensors of '{path}' are not those that were written: the sha256 of their bytes is "
            f"{found[:12]}..., the header says {header['data_sha256'][:12]}...; copy "
            "or convert the file again"
        )


def _gather(file: Any, names: list[str], dtype: np.dtype, path: Path) -> dict[str, Any]:
    """Leaves as a tree, those of all blocks stacked."""
    from flax.traverse_util import unflatten_dict

    leaves: dict[str, np.ndarray] = {}
    depth = 1 + max(int(n.split(".")[1]) for n in names if n.startswith(_STACKED))
    for name in sorted(names):
        leaf = file.get_tensor(name)
        if leaf.dtype != dtype and name != "periods":
            raise WeightsError(f"'{name}' in '{path}' is {leaf.dtype}, the header says {dtype}")
        if not name.startswith(_STACKED):
            leaves[name] = leaf
            continue
        _, block, own = name.split(".", 2)
        if (key := _STACKED + own) not in leaves:
            leaves[key] = np.empty((depth, *leaf.shape), leaf.dtype)
        leaves[key][int(block)] = leaf
    return unflatten_dict(leaves, sep=".")
