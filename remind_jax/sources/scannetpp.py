"""ScanNet++ scenes; images and annotations may lie apart (file_formats.md)."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from remind_jax.errors import SourceError
from remind_jax.sources.file_tree import FileTree, join
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

    folder: str
    metadata_files: tuple[str, ...]  # candidates, best first
    by_position: bool  # numbered by the frame's place in the sequence


def find_images(tree: FileTree) -> str | None:
    """Folder of images, or video file, of a scene; None if the tree holds none of a scene."""
    folders = [f for f in IMAGE_FOLDERS if list_images(tree, f)]
    places = folders + [v for v in VIDEOS if tree.has_file(v)]
    return places[0] if places else None


def find_masks(tree: FileTree) -> MaskPlace | None:
    """Instance maps of a scene or of its annotations; None if there are none.

    Raises:
      SourceError: If there are several, none of a known name.
    """
    variants = [v for v in tree.folders_in(EXPORTED) if tree.files_in(join(EXPORTED, v))]
    if variants:
        known = [v for v in EXPORTED_VARIANTS if v in variants]
        if len(variants) > 1 and not known:
            raise SourceError(
                f"'{tree.locate(EXPORTED)}' holds several kinds of masks ({', '.join(variants)}); "
                f"leave one of them there, or name it {EXPORTED_VARIANTS[0]}"
            )
        chosen = (known or variants)[0]
        return MaskPlace(join(EXPORTED, chosen), (f"meta_{chosen}.json",), by_position=True)
    for folder in RENDERED_FOLDERS:
        if tree.files_in(folder):
            return MaskPlace(folder, RENDERED_LABELS, by_position=False)
    return None


def find_annotations_beside(path: Path) -> Path | None:
    """The annotations kept apart for `<root>/data/<scene>`; None if there are none."""
    if path.parent.name != "data":
        return None
    places = [path.parent.parent / root / path.name for root in ANNOTATION_ROOTS]
    return next((place for place in places if place.is_dir()), None)
