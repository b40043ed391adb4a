"""Sequences of precomputed patch features, `.npz` or `.npy`.

`.npy`: `[T, Hp, Wp, D]`, memory-mapped. `.npz`, by name:
    features  float [T, Hp, Wp, D]      required
    masks     whole numbers [T, H, W]   instance maps, 0 for nothing
    ids, labels   [K], [K]              class name of each instance id in `masks`
    images    uint8 [T, H, W, 3]        RGB, only for pictures of the result
    times_s   float [T]                 time stamps
    names     text [T]                  names of frames
"""

from __future__ import annotations

import functools
import zipfile
from collections.abc import Generator, Mapping
from pathlib import Path

import numpy as np

from remind_jax import files
from remind_jax.errors import SourceError, nearest_names
from remind_jax.sources.class_names import UNNAMED, ClassNames, read_metadata
from remind_jax.sources.label_maps import (
    Unlabelled,
    detections_in,
    instance_ids_in,
    require_classes,
)
from remind_jax.sources.source import Content, Entry, Report

FEATURE_SUFFIXES = (".npz", ".npy")
KNOWN_ARRAYS = ("features", "masks", "ids", "labels", "images", "times_s", "names")


class FeatureReader:
    """Features of one sequence.

    Args:
      arrays: Arrays by the names of this module.
      name: Name of the sequence.
      fps: Frames per second, where there are no `times_s`.
      file: The file for messages.
      classes: Class of each instance id in `masks`.
      unlabelled: What an instance without class is: an error, or left out.

    Raises:
      SourceError: If arrays are missing, unknown, of a wrong shape, or disagree in length.
    """

    kind = "features"

    def __init__(
        self,
        arrays: Mapping[str, np.ndarray],
        name: str,
        fps: float,
        file: str,
        classes: ClassNames,
        unlabelled: Unlabelled,
    ) -> None:
        _check_arrays(arrays, file)
        self._arrays = arrays
        self.name = name
        self.num_entries: int | None = len(self._arrays["features"])
        self._times_s = self._arrays.get("times_s", np.arange(self.num_entries) / fps)
        self.fps: float | None = _rate(self._times_s, fps)
        self._names = tuple(
            str(n)
            for n in self._arrays.get("names", [f"{i:06d}" for i in range(len(self._times_s))])
        )
        self.entry_names: tuple[str, ...] | None = self._names
        self._classes = classes
        if "masks" in self._arrays and unlabelled == "error":
            require_classes(self._classes, instance_ids_in(self._arrays["masks"]), file)

    def entries(self, report: Report) -> Generator[Entry, None, None]:
        """Yields one entry per frame."""
        del report
        for index, name in enumerate(self._names):
            read = functools.partial(self._read, index)
            yield Entry(index, float(self._times_s[index]), name, read)

    def _read(self, index: int) -> Content:
        features = np.asarray(self._arrays["features"][index], np.float32)
        image = self._arrays["images"][index] if "images" in self._arrays else None
        detections = None
        if "masks" in self._arrays:
            detections = detections_in(self._arrays["masks"][index], self._classes)
        return Content(image, detections, features)


def load_arrays(path: Path, single: str = "features") -> dict[str, np.ndarray]:
    """Reads a NumPy file without running anything that it may contain (no pickles).

    Args:
      path: The file.
      single: What the one array of a `.npy` file is.

    Raises:
      SourceError: If it is no NumPy file.
    """
    try:
        files.check_regular(path)
        if path.suffix.lower() == ".npy":
            return {single: np.load(path, mmap_mode="r", allow_pickle=False)}
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise SourceError(f"'{path}' cannot be read as a NumPy file: {error}") from error


def _check_arrays(arrays: Mapping[str, np.ndarray], file: str) -> None:
    for key in arrays:
        if key not in KNOWN_ARRAYS:
            raise SourceError(
                f"'{file}' holds an array '{key}'; {nearest_names(key, KNOWN_ARRAYS)}"
            )
    features = arrays.get("features")
    if features is None:
        raise SourceError(f"'{file}' holds no array 'features'; it must be [T, Hp, Wp, D]")
    if features.ndim != 4 or features.dtype.kind != "f" or 0 in features.shape[1:]:
        raise SourceError(
            f"features in '{file}' are {features.dtype} {features.shape}; they must be floats "
            "[T, Hp, Wp, D]"
        )
    for key, ndim, kinds in (("masks", 3, "ui"), ("images", 4, "u"), ("times_s", 1, "f")):
        if key in arrays and (arrays[key].ndim != ndim or arrays[key].dtype.kind not in kinds):
            raise SourceError(f"'{key}' in '{file}' is {arrays[key].dtype} {arrays[key].shape}")
    for key in ("masks", "images", "times_s", "names"):
        if key in arrays and len(arrays[key]) != len(features):
            raise SourceError(
                f"'{file}' has features for {len(features)} frames, but '{key}' for "
                f"{len(arrays[key])}"
            )


def find_classes(
    arrays: Mapping[str, np.ndarray], file: str, metadata: Path | None, sequence: str
) -> ClassNames:
    """Classes from the metadata that was named, else from the arrays `ids` and `labels`.

    Raises:
      SourceError: If the metadata cannot be read, or says nothing about classes, or the arrays
        disagree in length.
    """
    if metadata is not None:
        return read_metadata(metadata, sequence).classes
    ids, labels = arrays.get("ids", np.empty(0)), arrays.get("labels", np.empty(0))
    if len(ids) != len(labels):
        raise SourceError(f"'{file}' needs as many 'labels' as 'ids', one class name per id")
    by_id = {int(i): str(label) for i, label in zip(ids, labels, strict=True)}
    return ClassNames(by_id, file=file) if "ids" in arrays else UNNAMED


def _rate(times_s: np.ndarray, fps: float) -> float | None:
    if len(times_s) < 2 or times_s[-1] <= times_s[0]:
        return fps
    return float((len(times_s) - 1) / (times_s[-1] - times_s[0]))
