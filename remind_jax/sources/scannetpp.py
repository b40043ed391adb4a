"""ScanNet++ scenes, as folders or tars; images and annotations may lie apart (file_formats.md)."""

from __future__ import annotations

import dataclasses
from pathlib import Path, PurePosixPath

from remind_jax.errors import SourceError, nearest_names
from remind_jax.sources.file_tree import TAR_SUFFIXES, FileTree, join
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
VARIANT_ALIASES = {"benchmark": "benchmark_instance", "bench": "benchmark_instance"}
RENDERED_FOLDERS = ("obj_ids", "instances", "masks")
RENDERED_LABELS = ("metadata.json", "scans/segments_anno.json")
ANNOTATION_ROOTS = ("annotations", "2Dmasks")


@dataclasses.dataclass(frozen=True)
class MaskPlace:
    """Where the instance maps of a scene are."""

    folder: str
    metadata_files: tuple[str, ...]  # candidates, best first
    by_position: bool  # numbered by the frame's place in the sequence


def is_scene(tree: FileTree) -> bool:
    """Whether the tree holds images where a scene has them."""
    return bool(_image_places(tree))


def find_images(tree: FileTree, images: str | None = None) -> str:
    """Folder of images, or video file, of a scene.

    Raises:
      SourceError: If `images` names something that is not there.
    """
    places = _image_places(tree)
    if images is None:
        return places[0]
    chosen = str(PurePosixPath(images))
    if chosen in places or tree.has_file(chosen) or list_images(tree, chosen):
        return chosen
    raise SourceError(f"'{tree.path}' has no images in '{images}'; {nearest_names(images, places)}")


def find_masks(tree: FileTree, variant: str | None = None) -> MaskPlace | None:
    """Instance maps of a scene or of its annotations; None if there are none.

    Raises:
      SourceError: If `variant` is not there, or several are and none was chosen.
    """
    variants = [v for v in tree.folders_in(EXPORTED) if tree.files_in(join(EXPORTED, v))]
    if variants:
        chosen = _choose_variant(tree, variants, variant)
        return MaskPlace(join(EXPORTED, chosen), (f"meta_{chosen}.json",), by_position=True)
    for folder in RENDERED_FOLDERS:
        if tree.files_in(folder):
            return MaskPlace(folder, RENDERED_LABELS, by_position=False)
    return None


def find_annotations_beside(path: Path) -> Path | None:
    """The annotations kept apart for `<root>/data/<scene>[.tar]`; None if there are none."""
    if path.parent.name != "data":
        return None
    scene = scene_name(path)
    for root in ANNOTATION_ROOTS:
        for suffix in ("", *TAR_SUFFIXES):
            candidate = path.parent.parent / root / f"{scene}{suffix}"
            if candidate.exists():
                return candidate
    return None


def scene_name(path: Path) -> str:
    """Name of a scene: that of its folder, or of its tar without the suffix."""
    for suffix in sorted(TAR_SUFFIXES, key=len, reverse=True):
        if path.name.lower().endswith(suffix) and not path.is_dir():
            return path.name[: -len(suffix)]
    return path.name


def _image_places(tree: FileTree) -> list[str]:
    folders = [f for f in IMAGE_FOLDERS if list_images(tree, f)]
    return folders + [v for v in VIDEOS if tree.has_file(v)]


def _choose_variant(tree: FileTree, variants: list[str], variant: str | None) -> str:
    if variant is not None:
        chosen = VARIANT_ALIASES.get(variant, variant)
        if chosen not in variants:
            raise SourceError(
                f"'{tree.locate(EXPORTED)}' has no masks '{variant}'; "
                f"{nearest_names(chosen, variants)}"
            )
        return chosen
    preferred = [v for v in EXPORTED_VARIANTS if v in variants] or variants
    if len(preferred) > 1 and preferred[0] not in EXPORTED_VARIANTS:
        raise SourceError(
            f"'{tree.locate(EXPORTED)}' holds several kinds of masks; choose one with "
            f"mask_variant= ({', '.join(variants)})"
        )
    return preferred[0]
