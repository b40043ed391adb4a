"""The DAVIS layout: `JPEGImages/<sequence>` beside `Annotations/<sequence>`, and its metadata."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from remind_jax.errors import SourceError, nearest_names
from remind_jax.sources.file_tree import FileTree, join
from remind_jax.sources.image_folder import list_images

IMAGES, ANNOTATIONS = "JPEGImages", "Annotations"


def is_davis(tree: FileTree) -> bool:
    """Whether the tree has the layout."""
    return IMAGES in tree.folders_in("")


def split_davis_path(path: Path) -> tuple[Path, str] | None:
    """Root and sequence of a path at or below a `JPEGImages` folder; None for another path."""
    for parent in (path, *path.parents):
        if parent.name == IMAGES:
            return parent.parent, path.relative_to(parent).as_posix().removeprefix(".")
    return None


def find_sequence(tree: FileTree, sequence: str | None) -> str:
    """The folder of a sequence below `JPEGImages` (`bear`, `480p/bear`, or `""`).

    Raises:
      SourceError: If there is none, or there are several and none or another one was named.
    """
    if sequence and list_images(tree, join(IMAGES, sequence)):
        return sequence
    found = list_sequences(tree)
    if not found:
        raise SourceError(f"'{tree.locate(IMAGES)}' holds no sequence of images")
    if sequence is None:
        if len(found) > 1:
            raise SourceError(
                f"'{tree.path}' holds {len(found)} sequences; choose one with sequence=, "
                f"for instance '{found[0]}' (others: {', '.join(found[1:6])})"
            )
        return found[0]
    named = [f for f in found if sequence in (f, PurePosixPath(f).name)]
    if len(named) == 1:
        return named[0]
    if named:
        raise SourceError(
            f"sequence '{sequence}' exists {len(named)} times in '{tree.path}'; name one of "
            + ", ".join(named)
        )
    raise SourceError(
        f"'{tree.path}' holds no sequence '{sequence}'; {nearest_names(sequence, found)}"
    )


def list_sequences(tree: FileTree) -> list[str]:
    """Folders with images at most two levels below `JPEGImages`."""
    if list_images(tree, IMAGES):
        return [""]
    found: list[str] = []
    for outer in tree.folders_in(IMAGES):
        if list_images(tree, join(IMAGES, outer)):
            found.append(outer)
            continue
        inner = [join(outer, name) for name in tree.folders_in(join(IMAGES, outer))]
        found += [name for name in inner if list_images(tree, join(IMAGES, name))]
    return found


def annotation_folder(tree: FileTree, sequence: str) -> str | None:
    """The folder of instance maps of a sequence; None if there is none."""
    folder = join(ANNOTATIONS, sequence)
    return folder if tree.files_in(folder) else None


def metadata_files(sequence: str) -> list[str]:
    """Where metadata of a sequence may lie, best first."""
    name = PurePosixPath(sequence).name
    return [
        f"{join(ANNOTATIONS, sequence)}/metadata.json",
        "metadata.json",
        *(f"meta{n}.json" for n in dict.fromkeys((name, name.upper(), name.lower())) if n),
        "meta.json",
    ]
