"""The DAVIS layout: `JPEGImages/<sequence>` beside `Annotations/<sequence>`, and its metadata."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from remind_jax.errors import SourceError, nearest_names
from remind_jax.sources.file_tree import files_in, folders_in
from remind_jax.sources.image_folder import list_images

IMAGES, ANNOTATIONS = "JPEGImages", "Annotations"


def is_davis(root: Path) -> bool:
    """Whether a folder has the layout."""
    return IMAGES in folders_in(root)


def split_davis_path(path: Path) -> tuple[Path, str] | None:
    """Root and sequence of a path at or below a `JPEGImages` folder; None for another path."""
    for parent in (path, *path.parents):
        if parent.name == IMAGES:
            return parent.parent, path.relative_to(parent).as_posix().removeprefix(".")
    return None


def find_sequence(root: Path, sequence: str | None) -> str:
    """The folder of a sequence below `JPEGImages` (`bear`, `480p/bear`, or `""`).

    Raises:
      SourceError: If there is none, or there are several and none or another one was named.
    """
    if sequence and list_images(root / IMAGES / sequence):
        return sequence
    found = list_sequences(root)
    if not found:
        raise SourceError(f"'{root / IMAGES}' holds no sequence of images")
    named = [f for f in found if sequence in (None, f, PurePosixPath(f).name)]
    if len(named) == 1:
        return named[0]
    if named:
        raise SourceError(
            f"'{root}' holds {len(named)} sequences{f' {sequence!r}' if sequence else ''}; choose "
            f"one by sequence (--sequence): {', '.join(named[:6])}"
        )
    hint = nearest_names(str(sequence), found)
    raise SourceError(f"'{root}' holds no sequence '{sequence}'; {hint}")


def list_sequences(root: Path) -> list[str]:
    """Folders with images at most two levels below `JPEGImages`."""
    images = root / IMAGES
    if list_images(images):
        return [""]
    found: list[str] = []
    for outer in folders_in(images):
        if list_images(images / outer):
            found.append(outer)
            continue
        inner = [f"{outer}/{name}" for name in folders_in(images / outer)]
        found += [name for name in inner if list_images(images / name)]
    return found


def annotation_folder(root: Path, sequence: str) -> Path | None:
    """The folder of instance maps of a sequence; None if there is none."""
    folder = root / ANNOTATIONS / sequence
    return folder if files_in(folder) else None


def metadata_files(sequence: str) -> list[str]:
    """Where metadata of a sequence may lie, best first."""
    name = PurePosixPath(sequence).name
    return [
        f"{ANNOTATIONS}/{sequence}/metadata.json",
        "metadata.json",
        *(f"meta{n}.json" for n in dict.fromkeys((name, name.upper(), name.lower())) if n),
        "meta.json",
    ]
