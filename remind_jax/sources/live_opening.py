"""Opens what goes on by itself: cameras, streams and folders that grow."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from remind_jax.errors import OptionError, SourceError
from remind_jax.sources.address import CameraAddress, read_address
from remind_jax.sources.capture import open_capture
from remind_jax.sources.growing_folder import GrowingFolder, GrowingMaps, find_growing
from remind_jax.sources.layouts import Choice
from remind_jax.sources.live_source import LiveOptions, LiveReader, LiveSource
from remind_jax.sources.sampling import Sampling


def open_live(
    spec: Any,
    masks: Any,
    choice: Choice,
    sampling: Sampling,
    options: LiveOptions,
    *,
    allow_size_change: bool = False,
) -> LiveSource | None:
    """Opens a source that goes on by itself; None if it is another one.

    Args:
      spec: Number of a camera, path of its device, address of a stream, or, with `options.follow`,
        a folder.
      masks: Folder of instance maps that come along with a folder that grows; `"none"` for none.
      choice: Name, metadata and `unlabelled` are used.
      sampling: Which frames are taken.
      options: How it is read.
      allow_size_change: Yield frames whose size differs from the first; else they are skipped.

    Raises:
      SourceError: If it cannot be opened, or masks are given that cannot come along.
    """
    address = read_address(spec)
    if address is None and not options.follow:
        return None
    if address is None:
        reader, maps = _open_folder(spec, masks, choice, options)
    elif options.follow:
        raise OptionError(
            f"'follow' is for a folder that grows; '{address.shown}' goes on by itself, leave it "
            "out",
            "follow",
        )
    elif masks is not None and not _is_none(masks):
        raise SourceError(
            f"'{address.shown}' is live, so that no masks can belong to its frames; give a "
            "detector, or a folder that grows, with masks"
        )
    else:
        kind = "camera" if isinstance(address, CameraAddress) else "stream"
        open_it = functools.partial(open_capture, address)
        reader = LiveReader(kind, choice.name or address.name, address.shown, open_it, options)
        maps = None
    return LiveSource(reader, maps, sampling, allow_size_change=allow_size_change)


def _open_folder(
    spec: Any, masks: Any, choice: Choice, options: LiveOptions
) -> tuple[LiveReader, GrowingMaps | None]:
    """A folder that grows, and the maps that come along."""
    if not isinstance(spec, str | Path):
        raise SourceError(
            f"a {type(spec).__name__} is no folder that grows; give the path of one, or leave out "
            "follow"
        )
    folder, beside = find_growing(Path(spec).expanduser().absolute())
    if masks is not None and not isinstance(masks, str | Path):
        raise SourceError(
            f"masks of type {type(masks).__name__} cannot come along with a folder that grows; "
            "give the folder of its instance maps"
        )
    where = beside if masks is None else Path(masks).expanduser().absolute()
    name = choice.name or folder.name
    maps = None
    if where is not None and not _is_none(masks):
        if not where.is_dir():
            raise SourceError(
                f"masks that come along with a folder that grows must be a folder of instance maps "
                f"(.png), and '{where}' is none"
            )
        maps = GrowingMaps(where, choice.metadata, name, choice.unlabelled)
    newest = not options.every_frame
    open_it = functools.partial(GrowingFolder, folder, maps, newest)
    return LiveReader("folder", name, str(folder), open_it, options), maps


def _is_none(masks: Any) -> bool:
    return isinstance(masks, str) and masks == "none"
