"""The scenes of a data set, found by its layout."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from remind_jax.errors import SourceError, nearest_names
from remind_jax.sources import davis, open_source, scannetpp
from remind_jax.sources.file_tree import files_in
from remind_jax.sources.sampling import Sampling
from remind_jax.sources.source import Source

Layout = Literal["davis", "scannetpp"]


@dataclasses.dataclass(frozen=True)
class Scene:
    """One sequence of a data set."""

    name: str
    path: Path
    layout: Layout
    has_masks: bool  # annotations, without which nothing can be scored
    sequence: str | None = None  # of a DAVIS folder

    def open(self, sampling: Sampling | None = None, *, masks: bool = True) -> Source:
        """Opens the frames, with annotations as detections if `masks`."""
        options: dict[str, Any] = {"sampling": sampling, "name": self.name}
        if not masks:
            options["masks"] = "none"
        if self.sequence is not None:
            options["sequence"] = self.sequence
        return open_source(self.path, **options)

    def digest(self) -> str:
        """Hash of the files of frames, masks and metadata, wherever they lie."""
        digest = hashlib.sha256()
        for place in self._places():
            files = [place / name for name in files_in(place)] if place.is_dir() else [place]
            for file in filter(Path.is_file, files):
                digest.update(os.fsencode(file.name) + b"\0")
                with contextlib.suppress(OSError), file.open("rb") as stream:
                    digest.update(hashlib.file_digest(stream, "sha256").digest())
        return digest.hexdigest()

    def _places(self) -> list[Path]:
        """Files, and folders of files, that it is read from; some may be missing."""
        if self.layout == "davis":
            sequence = self.sequence or ""
            folders = (f"{name}/{sequence}" for name in (davis.IMAGES, davis.ANNOTATIONS))
            return [self.path / name for name in (*folders, *davis.metadata_files(sequence))]
        annotated, masks = scannetpp.find_annotations(self.path)
        found = [scannetpp.find_images(self.path)]
        if masks is not None:
            found += [masks.folder, *(annotated / name for name in masks.metadata_files)]
        return [place for place in found if place is not None]


def find_scenes(root: str | Path) -> tuple[Scene, ...]:
    """Finds every scene of a data set.

    Args:
      root: A DAVIS folder with one or more sequences, a ScanNet++ folder (`data/<scene>`, with
        annotations beside it), one scene, or a folder of any of these.

    Raises:
      SourceError: If there is no scene, or two of one name.
    """
    root = Path(root).expanduser()
    if not root.is_dir():
        raise SourceError(f"'{root}' is no folder; give the root of a data set")
    data = root / "data"
    places = sorted(data.iterdir()) if data.is_dir() else [root]
    scenes = [scene for place in places for scene in _scenes_at(place)]
    if not scenes and not data.is_dir():
        below = sorted(p for p in root.iterdir() if p.is_dir())
        scenes = [scene for place in below for scene in _scenes_at(place)]
    if not scenes:
        raise SourceError(
            f"'{root}' holds no scenes; recognized are JPEGImages/<sequence> (DAVIS), data/<scene> "
            "(ScanNet++) and folders of these"
        )
    names = [scene.name for scene in scenes]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise SourceError(f"'{root}' holds several scenes named '{twice[0]}'; rename them")
    return tuple(scenes)


def select_scenes(scenes: tuple[Scene, ...], names: tuple[str, ...]) -> tuple[Scene, ...]:
    """The named scenes in turn; all without names. Raises SourceError if one is not there."""
    known = {scene.name: scene for scene in scenes}
    for name in names:
        if name not in known:
            raise SourceError(f"there is no scene '{name}'; {nearest_names(name, known)}")
    return tuple(known[name] for name in names) if names else scenes


def _scenes_at(path: Path) -> list[Scene]:
    """Scenes of a folder; none if it is something else."""
    if not path.is_dir():
        return []
    if davis.is_davis(path):
        return [
            Scene(
                name=PurePosixPath(sequence).name or path.name,
                path=path,
                layout="davis",
                has_masks=davis.annotation_folder(path, sequence) is not None,
                sequence=sequence or None,
            )
            for sequence in davis.list_sequences(path)
        ]
    if scannetpp.find_images(path) is not None:
        has_masks = scannetpp.find_annotations(path)[1] is not None
        return [Scene(path.name, path, "scannetpp", has_masks)]
    return []
