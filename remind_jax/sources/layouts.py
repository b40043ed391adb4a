"""Recognizes what a path holds: where its frames are, and the masks that lie with them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from remind_jax.errors import OptionError, SourceError
from remind_jax.sources import davis, scannetpp
from remind_jax.sources.class_names import Metadata, find_metadata, read_metadata
from remind_jax.sources.file_tree import files_in, folders_in
from remind_jax.sources.image_folder import IMAGE_SUFFIXES, ImageReader, list_images
from remind_jax.sources.label_maps import MAP_SUFFIXES, LabelMaps, Unlabelled, list_maps
from remind_jax.sources.source import MaskProvider, Reader
from remind_jax.sources.video import VideoReader

METADATA_BESIDE_MASKS = ("metadata.json", "../metadata.json", "../../metadata.json")


@dataclasses.dataclass(frozen=True)
class Choice:
    """What the user chose among the things that a path may hold."""

    name: str | None = None  # name of the sequence
    sequence: str | None = None  # of a DAVIS folder
    metadata: Path | None = None
    unlabelled: Unlabelled = "error"  # what an instance without class is
    image_fps: float | None = None  # of images without times


# Frames, and what opens the masks where the layout has them.
Located = tuple[Reader, Callable[[], MaskProvider] | None]


def locate(path: Path, choice: Choice) -> Located:
    """Recognizes a file or folder with frames.

    Raises:
      SourceError: If it holds none, or several and none was chosen.
    """
    suffix = path.suffix.lower()
    name = choice.name or path.stem
    if path.is_dir():
        return _locate_in_folder(path, choice)
    if suffix in IMAGE_SUFFIXES:
        return ImageReader(path.parent, name, choice.image_fps, [path.name]), None
    if suffix in (".json", ".jsonl"):
        raise SourceError(f"'{path}' may hold masks, but no frames; give it as masks")
    return VideoReader(path, name), None


def open_maps_at(path: Path, reader: Reader, choice: Choice) -> LabelMaps:
    """Opens the instance maps of a folder that was named for them; SourceError if it has none."""
    if not path.is_dir():
        raise SourceError(
            f"'{path}' is no folder; masks are a folder of instance maps "
            f"({', '.join(MAP_SUFFIXES)}) or COCO run-length JSON"
        )
    if list_maps(path):
        metadata = _metadata(path, METADATA_BESIDE_MASKS, reader.name, choice)
        return _maps(path, reader, metadata, choice)()
    place = scannetpp.find_masks(path)
    if place is not None:
        metadata = _metadata(path, place.metadata_files, reader.name, choice)
        return _maps(place.folder, reader, metadata, choice, place.by_position)()
    for name in dict.fromkeys(n for n in (choice.sequence, reader.name) if n):
        for folder in (path / davis.ANNOTATIONS / name, path / name):
            if files_in(folder):
                metadata = _metadata(path, davis.metadata_files(name), name, choice)
                return _maps(folder, reader, metadata, choice)()
    raise SourceError(
        f"'{path}' holds no instance maps ({', '.join(MAP_SUFFIXES)}), neither directly nor in "
        f"{davis.ANNOTATIONS}/{reader.name} or {scannetpp.EXPORTED}/<variant>"
    )


def refuse_unused(choice: Choice, path: Path | None, masks: Any) -> None:
    """Raises OptionError if a sequence is named where source and masks leave no choice of one."""
    mask_folder = Path(masks) if isinstance(masks, str | Path) else None
    masks_have = mask_folder and mask_folder.is_dir() and not list_maps(mask_folder)
    source_has = path and (davis.is_davis(path) or davis.split_davis_path(path) is not None)
    if choice.sequence is None or masks_have or source_has:
        return
    source = "the source" if path is None else f"'{path}'"
    raise OptionError(
        f"'sequence' is {choice.sequence!r}, and {source} is no DAVIS folder that leaves a "
        "choice; leave it out",
        "sequence",
    )


def _locate_in_folder(path: Path, choice: Choice) -> Located:
    if (inside := davis.split_davis_path(path)) is not None:
        root, sequence = inside
        return _locate_davis(
            root, dataclasses.replace(choice, sequence=sequence or choice.sequence)
        )
    if davis.is_davis(path):
        return _locate_davis(path, choice)
    name = choice.name or path.name
    if list_images(path):
        return ImageReader(path, name, choice.image_fps), None
    images = scannetpp.find_images(path)
    if images is not None:
        return _locate_scene(path, images, name, choice)
    folders = [folder for folder in folders_in(path) if list_images(path / folder)]
    if len(folders) == 1:
        return ImageReader(path / folders[0], name, choice.image_fps), None
    hint = (
        f"; its folders {', '.join(folders[:4])} do: give one of them"
        if folders
        else "; recognized are a folder of images, JPEGImages/<sequence> and ScanNet++ scenes"
    )
    raise SourceError(f"'{path}' holds no images ({', '.join(IMAGE_SUFFIXES)}){hint}")


def _locate_davis(root: Path, choice: Choice) -> Located:
    sequence = davis.find_sequence(root, choice.sequence)
    name = choice.name or Path(sequence).name or root.name
    metadata = _metadata(root, davis.metadata_files(sequence), Path(sequence).name, choice)
    folder = root / davis.IMAGES / sequence
    reader = ImageReader(folder, name, choice.image_fps, metadata.frame_names)
    masks = davis.annotation_folder(root, sequence)
    if masks is None:
        return reader, None
    by_position = metadata.frame_names is not None and all(
        name.startswith("frame_") for name in files_in(masks)
    )
    return reader, _maps(masks, reader, metadata, choice, by_position)


def _locate_scene(path: Path, images: Path, name: str, choice: Choice) -> Located:
    annotated, place = scannetpp.find_annotations(path)
    metadata = _metadata(annotated, place.metadata_files if place else (), name, choice)
    if images.is_file():
        reader: Reader = VideoReader(images, name)
    else:
        reader = ImageReader(images, name, choice.image_fps, metadata.frame_names)
    if place is None:
        return reader, None
    return reader, _maps(place.folder, reader, metadata, choice, place.by_position)


def _maps(
    folder: Path, reader: Reader, metadata: Metadata, choice: Choice, by_position: bool = False
) -> functools.partial[LabelMaps]:
    classes, unlabelled = metadata.classes, choice.unlabelled
    return functools.partial(
        LabelMaps, folder, reader, classes, unlabelled, by_position=by_position
    )


def _metadata(folder: Path, candidates: Sequence[str], sequence: str, choice: Choice) -> Metadata:
    """The metadata that was named, else the first of the candidates."""
    if choice.metadata is not None:
        return read_metadata(choice.metadata, sequence)
    return find_metadata(folder, candidates, sequence)
