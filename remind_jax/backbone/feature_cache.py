"""Patch features on disk: one file per image, named by a hash of image, backbone and fingerprint.

A digest of name and content follows the array, so that a damaged file is found and made anew.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.backbone.registry import Backbone
from remind_jax.errors import OutputError
from remind_jax.files import as_path, make_folder, read_bytes, replace_file, user_cache_folder

_DIGEST_BYTES = 32


def default_folder() -> Path:
    """Where features are kept if nothing else is said."""
    return user_cache_folder() / "features"


def cache_features(backbone: Backbone, folder: str | Path) -> Backbone:
    """The same backbone, which computes only what is not in a folder yet.

    It cannot be traced. Attention is not kept, nor what the backbone says of closeups only
    (`apply_closeups`).

    Raises:
      OutputError: If the folder cannot be made.
    """
    folder = as_path(folder, "the feature cache", OutputError)
    make_folder(folder)

    def apply(images: UInt8[np.ndarray, "B H W 3"]) -> Float[jax.Array, "B Hp Wp D"]:
        images = np.asarray(images)
        places = [folder / place_of(image, backbone) for image in images]
        rows, columns = (side // backbone.patch_px for side in images.shape[1:3])
        features = [_load(file, (rows, columns, backbone.dim)) for file in places]
        missing = [i for i, found in enumerate(features) if found is None]
        for i in missing:
            # One by one: another program would be compiled for every number of them.
            new = np.asarray(backbone.extract(images[i : i + 1]), np.float32)[0]
            make_folder(places[i].parent)
            replace_file(places[i], _as_file(places[i], new))
            features[i] = new
        return jnp.stack([jnp.asarray(one) for one in features])

    return dataclasses.replace(backbone, apply=apply, apply_to=None)


def place_of(image: UInt8[np.ndarray, "H W 3"], backbone: Backbone) -> Path:
    """File of one image, below the folder."""
    digest = hashlib.sha256()
    for part in (backbone.name, backbone.fingerprint, str(image.shape)):
        digest.update(part.encode() + b"\0")
    digest.update(np.ascontiguousarray(image).data)
    name = digest.hexdigest()
    return Path(name[:2]) / f"{name[2:]}.npy"


def _load(file: Path, shape: tuple[int, ...]) -> Float[np.ndarray, "Hp Wp D"] | None:
    """Features of a file; None if it is missing or damaged, for then it can be made again."""
    with contextlib.suppress(OSError, ValueError, EOFError):
        content = read_bytes(file)
        array, digest = content[:-_DIGEST_BYTES], content[-_DIGEST_BYTES:]
        if digest == _digest(file, array):
            features = np.load(io.BytesIO(array), allow_pickle=False)
            if features.shape == shape and features.dtype == np.float32:
                return features
    if file.is_dir():
        with contextlib.suppress(OSError):
            file.rmdir()  # one with something in it stays
    return None


def _as_file(file: Path, features: Float[np.ndarray, "Hp Wp D"]) -> bytes:
    content = io.BytesIO()
    np.save(content, features)
    array = content.getvalue()
    return array + _digest(file, array)


def _digest(file: Path, array: bytes) -> bytes:
    """Features under the name of others are none."""
    name = f"{file.parent.name}/{file.name}"
    return hashlib.sha256(name.encode() + b"\0" + array).digest()
