"""Given masks, one instance map per frame (DAVIS, ScanNet++, any folder of PNGs).

An annotation belongs to the frame of its stem, else of its number, else of its place.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Integer, Shaped

from remind_jax.crops import require_room
from remind_jax.errors import SourceError
from remind_jax.formats.pictures import VOID, read_label_map
from remind_jax.frame import Detections
from remind_jax.printing.words import plural
from remind_jax.sources.class_names import ClassNames
from remind_jax.sources.file_tree import files_in, frame_stem, last_number, read_of_frame
from remind_jax.sources.source import Entry, Reader, UnreadableFrame, say_size
from remind_jax.sources.video import VideoReader

Unlabelled = Literal["error", "skip"]
MAP_SUFFIXES = (".png", ".tif", ".tiff")
MAX_ASPECT_DIFFERENCE = 0.01
NUM_CHECKED = 3  # annotations looked at before work starts
_FEW_INSTANCES = 64


class LabelMaps:
    """Instance maps of a sequence.

    Args:
      by_position: The number in an annotation's name is the frame's place in the sequence,
        whatever the frame is called (ScanNet++, `frame_000012.png` with `frame_names`).

    Raises:
      SourceError: If no annotation belongs to any frame or can be used, or instances lack a class.
    """

    def __init__(
        self,
        folder: Path,
        reader: Reader,
        classes: ClassNames,
        unlabelled: Unlabelled = "error",
        *,
        by_position: bool = False,
    ) -> None:
        self._folder = folder
        self._classes, self._unlabelled = classes, unlabelled
        files = list_maps(folder)
        if not files:
            raise SourceError(f"'{folder}' holds no annotations ({', '.join(MAP_SUFFIXES)})")
        num = reader.num_entries
        if isinstance(reader, VideoReader) and not any(last_number(file) == 0 for file in files):
            num = reader.count()  # an estimate does not tell whether they are numbered from 1
        names = None if by_position else reader.entry_names
        self._file_of = match_annotations(files, names, num)
        if not self._file_of:
            frames = reader.entry_names
            raise SourceError(
                f"no annotation in '{folder}' belongs to a frame of '{reader.name}': "
                f"neither stems nor numbers agree (first annotation '{files[0]}', first frame "
                f"'{frames[0] if frames else '0'}')"
            )
        self.frames = self._file_of.keys()
        self.notes: list[str] = []
        is_estimate = isinstance(reader, VideoReader) and reader.end_s is not None
        num_frames = 0 if is_estimate else reader.num_entries or 0
        lacking = num_frames - len(self._file_of)
        if lacking > 0:
            self.notes.append(
                f"{lacking} of {num_frames} frames of '{reader.name}' have no annotation; those "
                "that are read count as frames without detections"
            )
        unused = sorted(set(files) - set(self._file_of.values()))
        if unused:
            self.notes.append(
                f"{plural(len(unused), 'annotation')} in '{folder}' (first '{unused[0]}') belong "
                f"to no frame of '{reader.name}'; see that both are numbered alike"
            )
        self._has_void = self._find_void()
        self._check_some()

    def detections_of(self, entry: Entry, frame_size: tuple[int, int]) -> Detections:
        """Instances of one frame, ascending by id, as boolean masks of the frame's size."""
        file = self._file_of.get(entry.source_index)
        if file is None:
            return Detections.empty(*frame_size)
        labels = fit_plane(self._read(file), frame_size, f"annotation '{file}'")
        ids = self._ids_in(labels)
        self._require_classes(ids)
        kept = [i for i in ids if self._classes[i] is not None]  # of class null, or skipped
        names = [str(self._classes[i]) for i in kept]
        return Detections.create(masks_of(labels, kept), names, instance_ids=kept)

    def _read(self, file: str) -> Integer[np.ndarray, "H W"]:
        try:
            return read_label_map(read_of_frame(self._folder / file))
        except UnreadableFrame as error:
            raise UnreadableFrame(f"its annotation '{file}' cannot be used: {error}") from error

    def _ids_in(self, labels: Integer[np.ndarray, "H W"]) -> list[int]:
        """The instances of a map, without the void of DAVIS."""
        void = VOID if self._has_void and labels.dtype == np.uint8 else None
        return [i for i in instance_ids_in(labels) if i != void]

    def _find_void(self) -> bool:
        """Whether 255 is void: not if classes name it, nor if no map holds anything else."""
        if VOID in self._classes.by_id:
            return False
        for file in self._file_of.values():
            with contextlib.suppress(UnreadableFrame):
                if any(i != VOID for i in instance_ids_in(self._read(file))):
                    return True
        return False

    def _check_some(self) -> None:
        """Looks at a few annotations, so that what all of them lack shows before work starts."""
        files = list(self._file_of.values())
        looked_at = np.unique(np.linspace(0, len(files) - 1, NUM_CHECKED).astype(int))
        reasons = []
        for at in looked_at:
            try:
                self._require_classes(self._ids_in(self._read(files[at])))
            except UnreadableFrame as error:
                reasons.append(str(error))
        if len(reasons) == len(looked_at):
            raise SourceError(
                f"'{self._folder}' holds no instance maps that can be used: "
                f"{reasons[0].removeprefix('its ')}"
            )

    def _require_classes(self, ids: list[int]) -> None:
        if self._unlabelled == "skip" or not self._classes.missing(ids):
            return
        all_ids: set[int] = set()  # so that everything that is to be mended is named at once
        for file in self._file_of.values():
            with contextlib.suppress(UnreadableFrame):
                all_ids.update(self._ids_in(self._read(file)))
        skip = ", or open the source with unlabelled='skip'"
        require_classes(self._classes, all_ids, str(self._folder), skip)


def list_maps(folder: Path) -> list[str]:
    """Names of the instance maps directly in a folder."""
    return [name for name in files_in(folder) if name.lower().endswith(MAP_SUFFIXES)]


def masks_of(labels: Integer[np.ndarray, "H W"], ids: Sequence[int]) -> Bool[np.ndarray, "N H W"]:
    """The mask of each of these instances, ascending.

    Raises:
      UnreadableFrame: If they are too many, or take more than is meant for a frame.
    """
    require_room(len(ids), labels.shape, "its instance map")
    masks = np.zeros((len(ids), *labels.shape), bool)
    if len(ids) <= _FEW_INSTANCES:
        for row, instance_id in enumerate(ids):
            np.equal(labels, instance_id, out=masks[row])
    else:  # time goes by the pixels, not by pixels times instances
        pixels = np.flatnonzero(np.isin(labels, ids))
        rows = np.searchsorted(ids, labels.ravel()[pixels])
        masks.reshape(len(ids), -1)[rows, pixels] = True
    return masks


def require_classes(
    classes: ClassNames, instance_ids: Iterable[int], place: str, otherwise: str = ""
) -> None:
    """Asks for a class of every instance.

    Args:
      otherwise: What else can be done, for the sentence.

    Raises:
      SourceError: If some have none; it names all of them and the file to mend.
    """
    missing = classes.missing(i for i in instance_ids if i > 0)
    if missing:
        raise SourceError(
            f"instances {', '.join(map(str, missing))} in '{place}' have no class; add them to "
            f"'{classes.file}' (null leaves one out){otherwise}"
        )


def fit_plane(
    plane: Shaped[np.ndarray, "H W"], frame_size: tuple[int, int], name: str
) -> Shaped[np.ndarray, "h w"]:
    """Brings an instance map or a mask to the frame's size by nearest neighbor.

    Raises:
      SourceError: If the aspect ratios differ by more than a hundredth.
    """
    if plane.shape == frame_size:
        return plane
    (height, width), (frame_height, frame_width) = plane.shape, frame_size
    ratio = (width * frame_height) / max(1, height * frame_width)
    if abs(ratio - 1) > MAX_ASPECT_DIFFERENCE:
        raise SourceError(
            f"{name} is {say_size((height, width))}, its frame is {say_size(frame_size)} (width x "
            "height): they show different pictures; give masks of the frame's size or aspect ratio"
        )
    if plane.dtype not in (np.uint8, np.uint16):  # OpenCV knows neither booleans nor uint32
        plane = plane.astype(np.uint8 if plane.dtype == bool else np.int32)
    return cv2.resize(plane, frame_size[::-1], interpolation=cv2.INTER_NEAREST)


def match_annotations(
    files: Sequence[str], frame_names: Sequence[str] | None, num_frames: int | None
) -> dict[int, str]:
    """Says which annotation belongs to which frame number, by the rules of this module.

    Args:
      frame_names: Names of the frames in order; None where annotations are numbered by the
        frame's place (videos): from 0, or from 1 where there is no annotation 0 and the last one
        equals the count of frames.

    Raises:
      SourceError: If two have one number, and it is the number that counts.
    """
    stems = {frame_stem(file): file for file in files}
    names = [] if frame_names is None else frame_names
    by_stem = {i: stems[frame_stem(n)] for i, n in enumerate(names) if frame_stem(n) in stems}
    if by_stem:
        return by_stem
    numbers: dict[int, str] = {}
    for file in files:
        number = last_number(file)
        if number is not None and numbers.setdefault(number, file) != file:
            raise SourceError(
                f"annotations '{numbers[number]}' and '{file}' both have the number {number}, and "
                "no name is that of a frame; give one instance map per frame, named after it"
            )
    if frame_names is None:
        first = 1 if 0 not in numbers and max(numbers, default=0) == num_frames else 0
        return {number - first: file for number, file in numbers.items()}
    by_number = {i: last_number(name) for i, name in enumerate(frame_names)}
    matched = {i: numbers[n] for i, n in by_number.items() if n is not None and n in numbers}
    if matched:
        return matched
    return dict(enumerate(files)) if len(files) == len(frame_names) else {}


def instance_ids_in(labels: Integer[np.ndarray, "..."]) -> list[int]:
    """The numbers above 0, ascending. Raises UnreadableFrame if there are negative ones."""
    if labels.dtype == bool or (labels.dtype.kind == "u" and labels.dtype.itemsize <= 2):
        # Counting takes a tenth of the time of sorting the pixels.
        num = 1 << 8 * labels.dtype.itemsize
        # In one piece: OpenCV reads past the end of what is repeated by strides of 0.
        pixels = np.ascontiguousarray(labels.reshape(-1, 1), f"u{labels.dtype.itemsize}")
        counts = cv2.calcHist([pixels], [0], None, [num], [0, num]) if pixels.size else []
        return [int(i) for i in np.flatnonzero(counts) if i > 0]
    ids = [int(i) for i in np.unique(labels)]
    if ids and ids[0] < 0:
        raise UnreadableFrame(
            f"an instance map holds {ids[0]}; give 0 for nothing, and numbers above 0"
        )
    return [i for i in ids if i > 0]
