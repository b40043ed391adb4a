"""ScanNet++ scenes; images and annotations may lie apart (file_formats.md)."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

from remind_jax.errors import SourceError
from remind_jax.sources.file_tree import files_in, folders_in
from remind_jax.sources.image_folder import list_images

IMAGE_FOLDERS = (
    "dslr/resized_images",
    "dslr/resized_undistorted_images",
    "iphone/rgb",
    "rgb",
    "images",
)
VIDEOS = ("iphone/rgb.mkv", "iphone/rgb.mp4")
EXPORTED = "annotations"
EXPORTED_VARIANTS = ("benchmark_instance", "raw")  # preferred first
RENDERED_FOLDERS = ("obj_ids", "instances", "masks")
RENDERED_LABELS = ("metadata.json", "scans/segments_anno.json")
ANNOTATION_ROOTS = ("annotations", "2Dmasks")


@dataclasses.dataclass(frozen=True)
class MaskPlace:
    """Where the instance maps of a scene are."""

    folder: Path
    metadata_files: tuple[str, ...]  # candidates, best first
    by_position: bool  # numbered by the frame's place in the sequence


def find_images(scene: Path) -> Path | None:
    """Folder of images, or video file, of a scene; None if there are none of a scene."""
    folders = [scene / folder for folder in IMAGE_FOLDERS if list_images(scene / folder)]
    places = folders + [scene / video for video in VIDEOS if os.path.isfile(scene / video)]
    return places[0] if places else None


def find_masks(scene: Path) -> MaskPlace | None:
    """Instance maps of a scene or of its annotations; None if there are none.

    Raises:
      SourceError: If there are several, none of a known name.
    """
    exported = scene / EXPORTED
    variants = [v for v in folders_in(exported) if files_in(exported / v)]
    if variants:
        known = [v for v in EXPORTED_VARIANTS if v in variants]
        if len(variants) > 1 and not known:
            raise SourceError(
                f"'{exported}' holds several kinds of masks ({', '.join(variants)}); "
                f"leave one of them there, or name it {EXPORTED_VARIANTS[0]}"
            )
        chosen = (known or variants)[0]
        return MaskPlace(exported / chosen, (f"meta_{chosen}.json",), by_position=True)
    for folder in RENDERED_FOLDERS:
        if files_in(scene / folder):
            return MaskPlace(scene / folder, RENDERED_LABELS, by_position=False)
    return None


def find_annotations(scene: Path) -> tuple[Path, MaskPlace | None]:
    """Where a scene has instance maps: in it, or kept apart for `<root>/data/<scene>`."""
    place = find_masks(scene)
    if place is None and scene.parent.name == "data":
        for root in ANNOTATION_ROOTS:
            beside = scene.parent.parent / root / scene.name
            if beside.is_dir():
                return beside, find_masks(beside)
    return scene, place
