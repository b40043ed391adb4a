"""Sequences of precomputed patch features: `.npy` `[T, Hp, Wp, D]`, or `.npz` by `KNOWN_ARRAYS`."""

from __future__ import annotations

import functools
import mmap
import warnings
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import cast

import numpy as np

from remind_jax import files
from remind_jax.errors import SourceError, nearest_names
from remind_jax.files.limits import MAX_LABEL, MAX_SIDE_PX
from remind_jax.files.tensors import read_npz
from remind_jax.sources.class_names import UNNAMED, ClassNames, read_metadata
from remind_jax.sources.label_maps import (
    Unlabelled,
    detections_in,
    instance_ids_in,
    require_classes,
)
from remind_jax.sources.sampling import MAX_TIME_S, mean_rate
from remind_jax.sources.source import DEFAULT_IMAGE_FPS, Content, Entry, Report, UnreadableFrame

FEATURE_SUFFIXES = (".npz", ".npy")
MAX_NAME = 1000  # characters of the name of a frame
KNOWN_ARRAYS = ("features", "masks", "ids", "labels", "images", "times_s", "names")


class FeatureReader:
    """Features of one sequence.

    Raises:
      SourceError: If arrays are missing, unknown, of a wrong shape, or disagree in length.
    """

    kind = "features"

    def __init__(
        self,
        arrays: Mapping[str, np.ndarray],
        name: str,
        fps: float | None,
        file: str,
        classes: ClassNames,
        unlabelled: Unlabelled,
    ) -> None:
        _check_arrays(arrays, file)
        self._arrays = arrays
        self.name = name
        self.num_entries: int | None = len(self._arrays["features"])
        self._is_timed = "times_s" in self._arrays or fps is not None
        shown_fps = fps or DEFAULT_IMAGE_FPS
        self._times_s = self._arrays.get("times_s", np.arange(self.num_entries) / shown_fps)
        self.fps: float | None = mean_rate(self._times_s, shown_fps)
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
            yield Entry(index, float(self._times_s[index]), name, read, self._is_timed)

    def _read(self, index: int) -> Content:
        with np.errstate(over="ignore"):
            features = np.asarray(read_part(self._arrays["features"], index), np.float32)
        image = self._arrays["images"][index] if "images" in self._arrays else None
        detections = None
        if "masks" in self._arrays:
            detections = detections_in(self._arrays["masks"][index], self._classes)
        return Content(image, detections, features)


def load_arrays(path: Path, single: str = "features") -> dict[str, np.ndarray]:
    """Reads a NumPy file without running anything that it may contain (no pickles).

    Raises:
      SourceError: If it is no NumPy file, or holds more than is meant for memory.
    """
    if path.suffix.lower() != ".npy":
        return read_npz(path, refused=SourceError)
    with files.reading(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sizes that overflow, which is an error as well
        files.check_regular(path)
        return {single: np.load(path, mmap_mode="r", allow_pickle=False)}


def read_part(array: np.ndarray, index: int) -> np.ndarray:
    """One frame of an array, which may lie in a file.

    Raises:
      UnreadableFrame: If the file was cut short meanwhile; to read it would end the process.
    """
    if isinstance(array, np.memmap) and isinstance(array.base, mmap.mmap):
        file = cast(mmap.mmap, array.base)
        if file.size() < array.offset + array.nbytes:
            raise UnreadableFrame("its file was cut short while it was read; write files anew")
        return np.array(array[index])
    return array[index]


def _check_arrays(arrays: Mapping[str, np.ndarray], file: str) -> None:
    for key in arrays:
        if key not in KNOWN_ARRAYS:
            raise SourceError(
                f"'{file}' holds an array '{key[:200]}'; {nearest_names(key, KNOWN_ARRAYS)}"
            )
    if "features" not in arrays:
        raise SourceError(f"'{file}' holds no array 'features'; it must be [T, Hp, Wp, D]")
    num = arrays["features"].shape[:1]
    for key, ndim, kinds, form in (
        ("features", 4, ("f2", "f4", "f8"), "floats [T, Hp, Wp, D]"),
        ("masks", 3, "ui", "whole numbers [T, H, W]"),
        ("images", 4, ("u1",), "bytes [T, H, W, 3]"),
        ("times_s", 1, "f", "floats [T]"),
        ("names", 1, "U", "text [T]"),
    ):
        array = arrays.get(key, None)
        if array is None:
            continue
        kind = array.dtype.kind if isinstance(kinds, str) else array.dtype.str[1:]
        if array.ndim != ndim or kind not in kinds or not _are_sides(array.shape[1:]):
            raise SourceError(
                f"'{key}' in '{file}' is {array.dtype} {array.shape}; it must be {form}, no side "
                f"over {MAX_SIDE_PX}"
            )
        if array.shape[:1] != num:
            raise SourceError(
                f"'{file}' has features for {num[0]} frames, but '{key}' for {len(array)}"
            )
    images, masks = arrays.get("images"), arrays.get("masks")
    if images is not None and (
        images.shape[3] != 3 or (masks is not None and images.shape[:3] != masks.shape)
    ):
        raise SourceError(
            f"'images' in '{file}' are {images.shape}; give bytes [T, H, W, 3] of the size of the "
            "masks"
        )
    times_s = arrays.get("times_s", np.zeros(0))
    if not (np.abs(times_s) < MAX_TIME_S).all() or (np.diff(times_s) < 0).any():
        raise SourceError(
            f"'times_s' in '{file}' must be finite, below {MAX_TIME_S:g} s, and in order"
        )
    for name in arrays.get("names", ()):
        if not 0 < len(name) <= MAX_NAME:
            raise SourceError(
                f"a name in 'names' of '{file}' has {len(name)} characters; give 1 to {MAX_NAME}"
            )


def _are_sides(shape: tuple[int, ...]) -> bool:
    return all(0 < side <= MAX_SIDE_PX for side in shape)


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
    ids, labels = arrays.get("ids", np.empty(0, int)), arrays.get("labels", np.empty(0, "U1"))
    if ids.ndim != 1 or labels.ndim != 1 or len(ids) != len(labels):
        raise SourceError(f"'{file}' needs as many 'labels' as 'ids', one class name per id")
    if ids.dtype.kind not in "ui" or labels.dtype.kind != "U":
        raise SourceError(
            f"'ids' and 'labels' in '{file}' are {ids.dtype} and {labels.dtype}; give whole "
            "numbers and text"
        )
    by_id: dict[int, str | None] = {}
    for number, label in zip(ids.tolist(), labels.tolist(), strict=True):
        if number in by_id or not 0 <= number < 2**31:
            raise SourceError(f"'ids' in '{file}' holds {number} twice, or out of range")
        if not label.strip() or len(label) > MAX_LABEL:
            raise SourceError(
                f"the label of instance {number} in '{file}' has {len(label)} characters; give a "
                f"name of 1 to {MAX_LABEL}"
            )
        by_id[number] = label
    return ClassNames(by_id, file=file) if "ids" in arrays else UNNAMED
