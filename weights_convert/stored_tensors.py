"""Weight files as mappings from names to tensors that are read when they are needed."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from safetensors import safe_open

from remind_jax.errors import WeightsError, first_line
from remind_jax.files import read_bytes, reading, say_no_file
from remind_jax.files.records import Text, read_json
from remind_jax.files.tensors import read_safetensors_header
from weights_convert.pickled_tensors import PickledTensor, read_pickled

INDEX_SUFFIX = ".safetensors.index.json"
PICKLED_SUFFIXES = (".pth", ".pt", ".bin", ".ckpt")
_MAX_JSON_BYTES = 16 << 20  # of an index or a configuration


class _Index(msgspec.Struct):
    """Which shard of a file holds which tensor."""

    weight_map: dict[Text, Text] = {}


@dataclasses.dataclass(frozen=True)
class StoredTensor:
    """One tensor of a file; `read` fetches its numbers."""

    shape: tuple[int, ...]
    read: Callable[[], np.ndarray]


@dataclasses.dataclass(frozen=True)
class WeightSource:
    """Everything that is known about a published file before its tensors are read."""

    path: Path
    files: tuple[Path, ...]  # that hold tensors, in order of name
    tensors: Mapping[str, Any]  # StoredTensor, and mappings of them in training checkpoints
    config: Mapping[str, Any]  # what Hugging Face's files beside it say; empty if there are none

    @functools.cached_property
    def sha256(self) -> str:
        """Of the bytes of all files."""
        digest = hashlib.sha256()
        for file in self.files:
            with file.open("rb") as stream:
                hashlib.file_digest(stream, lambda: digest)
        return digest.hexdigest()


def open_source(path: str | Path) -> WeightSource:
    """Opens a published weight file without running anything that it may contain.

    Args:
      path: `.safetensors` file, `.safetensors.index.json` of a sharded one, folder with either, or
        `.pth` file.

    Raises:
      WeightsError: If there is none, or it is damaged, cut short or of another kind.
    """
    path = Path(path)
    if path.is_dir():
        path = _find_in(path)
    if wrong := say_no_file(path):
        raise WeightsError(f"weight file '{path}' {wrong}; give a .pth or .safetensors file")
    if path.name.endswith(INDEX_SUFFIX):
        return _open_shards(path)
    if path.suffix == ".safetensors":
        for index in path.parent.glob(f"*{INDEX_SUFFIX}"):
            with reading(index, WeightsError):
                is_listed = path.name.encode() in read_bytes(index, _MAX_JSON_BYTES)
            if is_listed:
                raise WeightsError(f"'{path}' is one of several files of a network; give '{index}'")
        return WeightSource(path, (path,), _open_safetensors(path), _config_beside(path))
    if path.suffix in PICKLED_SUFFIXES:
        try:
            tensors = _as_stored(read_pickled(path))
        except WeightsError:
            raise
        except (RecursionError, ValueError) as error:  # it holds itself, or a name beyond measure
            raise WeightsError(
                f"'{path}' is no dictionary of tensors: {first_line(error)}"
            ) from error
        return WeightSource(path, (path,), tensors, _config_beside(path))
    raise WeightsError(
        f"'{path}' is no weight file; give the official .pth, or Hugging Face's .safetensors"
    )


def _find_in(folder: Path) -> Path:
    """The weight file of a Hugging Face folder."""
    for suffixes in (INDEX_SUFFIX, ".safetensors", PICKLED_SUFFIXES):
        found = sorted(file for file in folder.glob("*") if file.name.endswith(suffixes))
        if len(found) == 1:
            return found[0]
        if found:
            names = ", ".join(file.name for file in found)
            raise WeightsError(f"folder '{folder}' holds several weight files ({names}); name one")
    known = ", ".join((".safetensors", *PICKLED_SUFFIXES))
    raise WeightsError(f"folder '{folder}' holds no weight file ({known}); give one that does")


def _open_safetensors(path: Path) -> dict[str, StoredTensor]:
    header = read_safetensors_header(path, refused=WeightsError)
    with reading(path, WeightsError):
        file = safe_open(path, framework="np")
    return {
        name: StoredTensor(shape, functools.partial(_read, file, name, path))
        for name, shape in header.shapes.items()
    }


def _read(file: Any, name: str, path: Path) -> np.ndarray:
    with reading(path, WeightsError, place=f"tensor '{name}'"):
        return file.get_tensor(name)


def _open_shards(index: Path) -> WeightSource:
    listed = read_json(index, _Index, refused=WeightsError, max_bytes=_MAX_JSON_BYTES).weight_map
    if not listed:
        raise WeightsError(f"'{index}' lists no tensors; it needs a 'weight_map'")
    tensors: dict[str, StoredTensor] = {}
    # Names only: an index must not lead out of its folder.
    files = tuple(sorted({index.parent / Path(name).name for name in listed.values()}))
    for file in files:
        if not file.is_file():
            raise WeightsError(f"'{index}' lists {file.name!r}, which is missing beside it")
        held = _open_safetensors(file)
        names = (name for name, place in listed.items() if Path(place).name == file.name)
        tensors |= {name: held[name] for name in names if name in held}
    if missing := sorted(set(listed) - set(tensors)):
        raise WeightsError(
            f"'{index}' lists tensors that their files do not hold: {', '.join(missing)}"
        )
    return WeightSource(index, files, tensors, _config_beside(index))


def _config_beside(path: Path) -> Mapping[str, Any]:
    said: dict[str, Any] = {}
    for name in ("preprocessor_config.json", "config.json"):
        if (file := path.with_name(name)).is_file():
            said |= read_json(file, dict[str, Any], refused=WeightsError, max_bytes=_MAX_JSON_BYTES)
    if isinstance(timm := said.get("pretrained_cfg"), dict):
        said |= {f"image_{key}": timm[key] for key in ("mean", "std") if key in timm}
    return said


def _as_stored(values: Mapping[str, Any]) -> dict[str, Any]:
    """Pickled tensors under the same type; mappings stay, and all else is left out."""
    kept: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            kept[str(key)] = _as_stored(value)
        elif isinstance(value, PickledTensor):
            kept[str(key)] = StoredTensor(value.shape, value.read)
        elif hasattr(value, "detach"):
            kept[str(key)] = StoredTensor(tuple(value.shape), functools.partial(_from_torch, value))
    return kept


def _from_torch(tensor: Any) -> np.ndarray:
    return tensor.detach().float().numpy()
