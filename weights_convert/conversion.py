"""`convert`: a published weight file becomes ours, tensor by tensor, in little memory."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import json
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np

import remind_jax
from remind_jax.backbone.vit_variants import CUSTOM, TERMS, Terms, Variant
from remind_jax.backbone.vit_weights import (
    DTYPES,
    FORMAT,
    SCHEMA_VERSION,
    default_folder,
    leaf_shapes,
)
from remind_jax.errors import OutputError, WeightsError
from remind_jax.files import make_folder, refuse_file, replacing
from weights_convert.key_layouts import NamedTensors, name_tensors
from weights_convert.leaf_recipes import Recipe, check_complete, make_leaf, recipes
from weights_convert.stored_tensors import WeightSource, open_source
from weights_convert.variant_detection import Wishes, detect_variant

Dtype = Literal["float32", "bfloat16"]
_CODES = {"float32": "F32", "bfloat16": "BF16"}
# Rotary angles are computed from them: rounding would turn patches elsewhere.
_ALWAYS_FLOAT32 = "periods"
_HASH_PLACE = "0" * 64
_ALIGNMENT = 8


@dataclasses.dataclass(frozen=True)
class Conversion:
    """What was done."""

    path: Path
    variant: Variant
    layout: str
    source_sha256: str  # of the published file
    data_sha256: str  # of the tensors written
    num_bytes: int  # of the file written
    dropped: tuple[str, ...]  # keys of the source that only training needs

    @property
    def licence(self) -> str:
        """What the weights may be used for, and where to read it."""
        terms = _terms(self.variant)
        return f"{terms.license}, {terms.license_url}"


def convert(
    source: str | Path,
    out: str | Path | None,
    *,
    wishes: Wishes | None = None,
    dtype: Dtype = "float32",
    overwrite: bool = False,
    origin: str | None = None,
) -> Conversion:
    """Converts one network.

    Args:
      out: File to write; appears only when it is complete. `NAME.safetensors` in the folder where
        backbones look for it if None.

    Raises:
      WeightsError: If the source is not exactly one of the known networks.
      OutputError: If the file exists or cannot be written.
    """
    if out is not None:
        _check_free(Path(out), overwrite)
        refuse_file(Path(out), [source])
    opened = open_source(source)
    file = str(opened.path)
    named = name_tensors(opened.tensors, file)
    variant = detect_variant(named, opened.config, wishes or Wishes(), file)
    wanted = recipes(variant, named.tensors)
    check_complete(wanted, named.tensors, named.source_keys, named.unexpected, file, variant.name)
    if out is None:
        out = default_folder() / f"{variant.name}.safetensors"
        _check_free(out, overwrite)
    out = Path(out)
    metadata = _metadata(opened, named, variant, dtype, origin or opened.path.name)
    make_folder(out.parent)
    with replacing(out) as unfinished, unfinished.open("wb") as stream:
        digest = _write(stream, wanted, named, variant, metadata, dtype, file)
    num_bytes = out.stat().st_size
    return Conversion(
        out, variant, named.layout.name, opened.sha256, digest, num_bytes, named.dropped
    )


def _check_free(out: Path, overwrite: bool) -> None:
    if out.suffix != ".safetensors":
        raise OutputError(f"'{out}' must end in .safetensors")
    if out.exists() and not overwrite:
        raise OutputError(f"'{out}' exists; choose another name or allow overwriting")


def _terms(variant: Variant) -> Terms:
    """Those of the family; a network of its own in a common form may be anybody's."""
    if variant.name == CUSTOM and variant.family != "dinov3":
        return Terms("unknown license", "see where they came from", "")
    return TERMS[variant.family]


def _metadata(
    source: WeightSource, named: NamedTensors, variant: Variant, dtype: str, origin: str
) -> dict[str, str]:
    """What the header says of a file, besides its tensors."""
    terms = _terms(variant)
    return {
        "format": FORMAT,
        "schema": SCHEMA_VERSION,
        "variant": variant.name,
        "architecture": json.dumps(dataclasses.asdict(variant)),
        "dtype": dtype,
        "data_sha256": _HASH_PLACE,
        "source": origin,
        "source_sha256": source.sha256,
        "source_layout": named.layout.name,
        "licence": terms.license,
        "licence_notice": (
            f"Converted from {origin}; the weights remain under the {terms.license} of "
            f"their publisher, {terms.license_url}"
        ),
        "converted_by": f"remind-jax {remind_jax.__version__}",
        "converted_at": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def _write(
    stream: BinaryIO,
    wanted: list[Recipe],
    named: NamedTensors,
    variant: Variant,
    metadata: dict[str, str],
    dtype: Dtype,
    file: str,
) -> str:
    """Writes a safetensors file tensor by tensor; returns the sha256 of all tensor bytes.

    The library would want all tensors in memory. Its format: length of the header, header as JSON
    (padded to whole words), tensors one after another, the widest types first.
    """
    header: dict[str, object] = {"__metadata__": metadata}
    shapes, position = leaf_shapes(variant), 0
    wanted = sorted(wanted, key=lambda recipe: recipe.leaf != _ALWAYS_FLOAT32)
    types = {r.leaf: "float32" if r.leaf == _ALWAYS_FLOAT32 else dtype for r in wanted}
    for leaf, kind in types.items():
        num_bytes = int(np.prod(shapes[leaf])) * DTYPES[kind].itemsize
        header[leaf] = {
            "dtype": _CODES[kind],
            "shape": list(shapes[leaf]),
            "data_offsets": [position, position + num_bytes],
        }
        position += num_bytes
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % _ALIGNMENT)
    stream.write(len(text).to_bytes(8, "little") + text)

    digest = hashlib.sha256()
    for recipe in wanted:
        leaf = make_leaf(recipe, named.tensors, file).astype(DTYPES[types[recipe.leaf]])
        if leaf.shape != shapes[recipe.leaf]:
            raise WeightsError(f"'{recipe.leaf}' came out as {leaf.shape}: a defect, report it")
        data = leaf.tobytes()
        digest.update(data)
        stream.write(data)
    stream.seek(8 + text.index(_HASH_PLACE.encode()))
    stream.write(digest.hexdigest().encode())
    return digest.hexdigest()
