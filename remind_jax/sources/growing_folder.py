"""A folder that pictures are added to while they are read, with or without their masks.

A picture counts as there once it is whole and, where masks come along, its instance map is: the
file of the same stem (`00012.jpg` and `00012.png`, also `DSC1.JPG.png`). Names must rise in natural
order; a picture that sorts before one that was taken is never taken. Files that are renamed into
the folder when they are complete are seen a moment sooner than such as grow in it.
"""

from __future__ import annotations

import functools
import os
import threading
import time
from pathlib import Path, PurePosixPath

from remind_jax.errors import SourceError
from remind_jax.frame import Detections
from remind_jax.sources import davis
from remind_jax.sources.annotation_png import read_label_map
from remind_jax.sources.capture import Lost, Picture
from remind_jax.sources.class_names import UNNAMED, ClassNames, find_metadata, read_metadata
from remind_jax.sources.file_tree import FolderTree, natural_key
from remind_jax.sources.image_folder import IMAGE_SUFFIXES, decode_image
from remind_jax.sources.label_maps import (
    Unlabelled,
    detections_in,
    fit_plane,
    instance_ids_in,
    require_classes,
)
from remind_jax.sources.layouts import METADATA_BESIDE_MASKS
from remind_jax.sources.picture_file import check_picture
from remind_jax.sources.source import Content, Entry, UnreadableFrame

_LEAST_PAUSE_S = 0.02  # between two looks at the folder
_LOOKING_SHARE = 0.1  # of the time that looking may take
_SETTLED_S = 2.0  # a file that is not whole for so long will not get so
_MASK_SUFFIXES = (".png", ".tif", ".tiff")


class GrowingFolder:
    """Pictures of a folder as they come, a `Capture`.

    Args:
      folder: Where they are.
      masks: Where their instance maps are; None if none come.
      newest: Give the newest picture that is there each time, not the next.
      wait_s: Seconds without a new picture after which the folder counts as complete.

    Raises:
      SourceError: If the folder cannot be read.
    """

    def __init__(
        self, folder: Path, masks: GrowingMaps | None, newest: bool, wait_s: float
    ) -> None:
        self._tree, self._masks, self._wait_s = FolderTree(folder), masks, wait_s
        self._step = -1 if newest else 1
        self._over = threading.Event()
        self._known: set[str] = set()  # names that were sorted already
        self._ahead: list[str] = []  # of these, those not given yet, in order
        self._given: str | None = None
        self._num_given = 0  # the number of the next picture
        self._pause_s = _LEAST_PAUSE_S
        self._look()

    def read(self) -> Picture | None:
        """The next picture that is there; see `Capture`."""
        since = time.monotonic()
        while not self._over.is_set():
            places = range(len(self._ahead))[:: self._step]
            place = next((i for i in places if self._is_there(self._ahead[i])), None)
            if place is not None:
                return self._give(place)
            if time.monotonic() - since > self._wait_s:
                if self._given is None:
                    raise SourceError(
                        f"'{self._tree.path}' got no picture{self._with_masks} within "
                        f"{self._wait_s:g} s; is it the right folder?"
                    )
                raise Lost(f"got no picture for {self._wait_s:g} s")
            self._over.wait(self._pause_s)
            self._look()
        return None

    def interrupt(self) -> None:
        """Lets `read` give None."""
        self._over.set()

    def close(self) -> None:
        """Holds nothing open."""

    @property
    def _with_masks(self) -> str:
        return "" if self._masks is None else " with a mask"

    def _look(self) -> None:
        """Lists what is new; looks less often where there is much to look at."""
        start = time.monotonic()
        new = []
        for name in _list_names(self._tree.path):
            if name not in self._known and not name.startswith("."):
                self._known.add(name)
                if PurePosixPath(name).suffix.lower() in IMAGE_SUFFIXES:
                    new.append(name)
        if self._given is not None:
            last = natural_key(self._given)
            new = [name for name in new if natural_key(name) > last]
        if new:
            self._ahead = sorted([*self._ahead, *new], key=natural_key)
        took_s = time.monotonic() - start
        self._pause_s = max(_LEAST_PAUSE_S, took_s / _LOOKING_SHARE)

    def _give(self, place: int) -> Picture:
        """Gives a picture; those before it never are."""
        name = self._ahead[place]
        del self._ahead[: place + 1]
        self._given = name
        number = self._num_given + place
        self._num_given = number + 1
        return Picture(functools.partial(self._read, name), name, number)

    def _is_there(self, name: str) -> bool:
        has_mask = self._masks is None or self._masks.has_whole(name)
        return has_mask and _is_whole(self._tree, name)

    def _read(self, name: str) -> Content:
        return Content(decode_image(self._tree.read(name)))


class GrowingMaps:
    """Instance maps that come along with pictures, a `MaskProvider`.

    Args:
      folder: Where they are; it may come later.
      metadata: JSON with the class of each instance; found beside the maps if left out, once it is
        there.
      name: Of the sequence.
      unlabelled: What an instance without class is: an error, or left out.
    """

    def __init__(
        self, folder: Path, metadata: Path | None, name: str, unlabelled: Unlabelled
    ) -> None:
        self.notes: list[str] = []
        self.frames = None
        self._tree, self._name, self._unlabelled = FolderTree(folder), name, unlabelled
        self._metadata = metadata
        self._classes: ClassNames | None = None
        if metadata is not None:
            self._classes = read_metadata(metadata, name).classes

    def has_whole(self, picture: str) -> bool:
        """Whether the map of a picture is there and whole."""
        file = self._file_of(picture)
        return file is not None and _is_whole(self._tree, file)

    def detections_of(self, entry: Entry, frame_size: tuple[int, int]) -> Detections:
        """Instances of one frame, ascending by id.

        Raises:
          UnreadableFrame: If its map is gone or damaged.
          SourceError: If it shows another picture, or instances lack a class.
        """
        file = self._file_of(entry.name)
        if file is None:
            raise UnreadableFrame("its annotation is gone")
        try:
            labels = read_label_map(self._tree.read(file))
        except UnreadableFrame as error:
            raise UnreadableFrame(f"its annotation '{file}' cannot be used: {error}") from error
        labels = fit_plane(labels, frame_size, f"annotation '{file}'")
        ids = instance_ids_in(labels)
        return detections_in(labels, self._classes_of(ids), ids)

    def _classes_of(self, ids: list[int]) -> ClassNames:
        """The classes; the file that says them is read again for an id that it did not name."""
        known = self._classes
        if known is None or known is UNNAMED or known.missing(ids):
            known = (
                find_metadata(self._tree, METADATA_BESIDE_MASKS, self._name)
                if self._metadata is None
                else read_metadata(self._metadata, self._name)
            ).classes
            self._classes = known
        if self._unlabelled == "error":
            require_classes(known, ids, self._tree.locate(""))
        return known

    def _file_of(self, picture: str) -> str | None:
        stem = PurePosixPath(picture).stem
        names = (f"{name}{suffix}" for name in (stem, picture) for suffix in _MASK_SUFFIXES)
        return next((name for name in names if self._tree.has_file(name)), None)


def find_growing(folder: Path) -> tuple[Path, Path | None]:
    """The folder of pictures that is meant by a path, and that of their maps if the layout has one.

    Raises:
      SourceError: If it is no folder.
    """
    if not folder.is_dir():
        raise SourceError(f"'{folder}' is no folder; give the one that pictures are added to")
    inside = davis.split_davis_path(folder)
    if inside is None:
        return folder, None
    root, sequence = inside
    maps = root / davis.ANNOTATIONS / sequence
    return folder, maps if maps.is_dir() else None


def _list_names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError as error:
        raise SourceError(f"folder '{folder}' cannot be read: {error.strerror or error}") from error


def _is_whole(tree: FolderTree, name: str) -> bool:
    """Whether a file is complete, or has been as it is for long."""
    try:
        check_picture(tree.read(name))
    except UnreadableFrame:
        try:
            return time.time() - (tree.path / name).stat().st_mtime > _SETTLED_S
        except OSError:
            return False
    return True
