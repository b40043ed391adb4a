"""Patch features on disk: a file per image, named by a hash of image, backbone and fingerprint."""

from __future__ import annotations

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
from remind_jax.files import as_path, make_folder, user_cache_folder
from remind_jax.files.sealed import read_sealed, write_sealed


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
            _save(places[i], new)
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
    """Features of a file; None if it holds none of this shape, for then they can be made again."""
    content = read_sealed(file)
    if content is None:
        return None
    features = np.load(io.BytesIO(content), allow_pickle=False)
    return features if features.shape == shape else None


def _save(file: Path, features: Float[np.ndarray, "Hp Wp D"]) -> None:
    content = io.BytesIO()
    np.save(content, features)
    make_folder(file.parent)
    write_sealed(file, content.getvalue())
