"""One door to all inputs: `open_source` recognizes what it is given."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from remind_jax.errors import ConfigError, OptionError, SourceError, is_text, nearest_names
from remind_jax.files import as_path
from remind_jax.files.records import Text, check
from remind_jax.formats.coco import read_categories
from remind_jax.settings.ranges import check_option, read_options
from remind_jax.sources.arrays import ArrayMasks, ItemReader
from remind_jax.sources.coco_masks import CocoMasks
from remind_jax.sources.detections import ClassNaming, detections_from
from remind_jax.sources.file_tree import read_bytes
from remind_jax.sources.label_maps import Unlabelled
from remind_jax.sources.layouts import Choice, locate, open_maps_at, refuse_unused
from remind_jax.sources.live_source import RECONNECT_S, LiveOptions, open_live
from remind_jax.sources.sampling import MAX_RATE, MIN_RATE, Sampling
from remind_jax.sources.source import MaskProvider, Reader, SampledSource, Source

NO_MASKS = "none"

MAX_NAME = 1000  # characters
PACKED = (
    *(".zip", ".rar", ".7z", ".tar", ".tgz", ".tbz2", ".txz"),
    *(".gz", ".bz2", ".xz"),
)
_Value = Text | bool | int | float | None


class _Description(msgspec.Struct, frozen=True):
    """What `Source.describe` says; `open_source` checks its arguments itself."""

    name: Text | None = None
    reopen: dict[str, _Value | dict[str, _Value]] | None = None


def check_options(options: Mapping[str, Any], function: Callable[..., Any], **nested: type) -> None:
    """Refuses options that neither a function nor `open_source` has.

    Args:
      **nested: Dataclasses of options that the function takes together, beside `sampling`.

    Raises:
      ConfigError: If there is such an option.
    """
    known = {*inspect.signature(open_source).parameters} - {"spec"}
    own = {*inspect.signature(function).parameters} - {"source_options"}
    for name in options:
        if name in known or name in own:
            continue
        hint = nearest_names(name, known | own)
        for taker, kind in {"sampling": Sampling, **nested}.items():
            if name in [field.name for field in dataclasses.fields(kind)]:
                hint = f"give {taker}={{'{name}': ...}}"
        raise ConfigError(f"{function.__name__} has no option '{name}'; {hint}")


def open_source(
    spec: Any,
    *,
    masks: Any = None,
    sampling: Sampling | Mapping[str, Any] | None = None,
    metadata: str | Path | None = None,
    sequence: str | None = None,
    unlabelled: Unlabelled = "error",
    image_fps: float | None = None,
    allow_size_change: bool = False,
    class_names: ClassNaming | None = None,
    name: str | None = None,
    duration: float | None = None,
    reconnect: float = RECONNECT_S,
) -> Source:
    """Opens whatever holds frames.

    Args:
      spec: A camera (0, "/dev/video0"); the address of a stream (`"rtsp://..."`, `"http://..."`);
        a video; a folder of images; a DAVIS folder (its root, or a sequence in `JPEGImages`);
        a ScanNet++ scene; an array `[T, H, W, 3]`; an iterable of images, image paths, pairs
        (image, detections) or `Frame`s; a `Source`, which is returned as it is unless other options
        are given.
      masks: Detections kept apart: a folder of instance maps, a COCO-RLE file (`.json`,
        `.jsonl`), an array of instance maps `[T, H, W]`, or detections per source frame. Left out,
        those that belong to the layout; `"none"` ignores these.
      sampling: Which frames are processed.
      metadata: JSON with the class of each instance id, or with the names of COCO categories.
      sequence: Which one, where a DAVIS folder holds several.
      unlabelled: Whether annotated instances without class are an `"error"`, or `"skip"` leaves
        them out as the original tracker does.
      image_fps: Images per second where there are no time stamps; left out, it is not known: an
        image is a tenth of a second.
      allow_size_change: Yield frames whose size differs from the first; else they are skipped, but
        for those of a live source.
      class_names: Names of class ids (or instance ids of instance maps) of detections in memory.
      name: Name of the sequence; that of the file or folder if left out.
      duration: Seconds after which a live source ends.
      reconnect: Seconds that a live source may be lost; with 0, that is its end.

    Raises:
      SourceError: If nothing can be made of it; one sentence.
      ConfigError: If an option is out of range.
    """
    chosen = Sampling() if sampling is None else read_options("sampling", sampling, Sampling)
    if image_fps is not None:
        check_option("image_fps", image_fps, MIN_RATE, MAX_RATE, whole=False)
    for option, value in (("sequence", sequence), ("name", name)):
        is_name = isinstance(value, str) and 0 < len(value) <= MAX_NAME and is_text(value)
        if value is not None and not is_name:
            wanted = f"text of 1 to {MAX_NAME} characters"
            raise OptionError(f"'{option}' is {reprlib.repr(value)}; give {wanted}", option)
    if unlabelled not in ("error", "skip"):
        raise OptionError(f"'unlabelled' is {unlabelled!r}; give 'error' or 'skip'", "unlabelled")
    live = LiveOptions(duration, reconnect)
    if isinstance(spec, Source) and masks is None and name is None and chosen == Sampling():
        live.refuse_for_recordings(spec.name)
        return spec
    json_file = None if metadata is None else _existing(metadata)
    choice = Choice(name, sequence, json_file, unlabelled, image_fps)
    opened = open_live(spec, masks, name, chosen, live)
    if opened is not None:
        return opened
    live.refuse_for_recordings(str(spec)[:200] if isinstance(spec, str | Path) else "this source")
    reopen: dict[str, Any] | None = None
    if isinstance(spec, str | Path):
        path = _existing(spec)
        # Metadata that comes with other masks says nothing about those of the layout.
        own = dataclasses.replace(choice, metadata=None) if masks is not None else choice
        reader, open_own_masks = locate(path, own)
        if image_fps is not None and reader.kind == "video":
            raise OptionError(
                f"'image_fps' is for images, and the video '{path}' has a rate of its own; leave "
                "it out",
                "image_fps",
            )
        refuse_unused(choice, path, masks)
        reopen = dataclasses.asdict(choice) | {
            "spec": str(path),
            "masks": _masks_as_json(masks),
            "sampling": dataclasses.asdict(chosen),
            "metadata": None if json_file is None else str(json_file),
            "allow_size_change": allow_size_change,
        }
    else:
        reader, open_own_masks = _read_items(spec, choice, class_names), None
        refuse_unused(choice, None, masks)
    if masks is None:
        provider = open_own_masks() if open_own_masks is not None else None
    else:
        provider = _open_masks(masks, reader, choice, class_names)
    return SampledSource(
        reader, provider, chosen, allow_size_change=allow_size_change, reopen=reopen
    )


def reopen_source(description: Mapping[str, Any]) -> Source:
    """Opens again what `Source.describe` described.

    Masks that were given in memory are not there; the frames are.

    Raises:
      SourceError: If the frames came from memory, or are no longer where they were.
    """
    try:
        return open_source(**read_arguments(description))
    except ConfigError as error:
        raise SourceError(f"the description of the source: {error}") from error


def read_arguments(description: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `open_source` for a source that `Source.describe` described, maybe in a file.

    Raises:
      SourceError: If the frames came from memory, or the description is damaged.
    """
    said = check(dict(description), _Description, "the description of the source")
    if said.reopen is None:
        raise SourceError(
            f"source '{said.name}' came from memory or was live, and cannot be opened again; give "
            "its video or images (--source)"
        )
    if not isinstance(said.reopen.get("spec"), str):
        raise SourceError("the description of the source, `reopen`: `spec` is no path")
    check_options(said.reopen, open_source)
    return said.reopen


def _read_items(spec: Any, choice: Choice, class_names: ClassNaming | None) -> ItemReader:
    is_bytes = isinstance(spec, bytes | bytearray | memoryview)
    if is_bytes or (not isinstance(spec, Iterable) and not hasattr(spec, "__array__")):
        raise SourceError(
            f"a {type(spec).__name__} is no source of frames; give a path, an array [T, H, W, 3] "
            "or an iterable of images"
        )
    name = choice.name or getattr(spec, "name", None) or "frames"
    return ItemReader(spec, str(name), choice.image_fps, class_names)


def _open_masks(
    masks: Any, reader: Reader, choice: Choice, class_names: ClassNaming | None
) -> MaskProvider | None:
    if isinstance(masks, str) and masks == NO_MASKS:
        return None
    if isinstance(masks, str | Path):
        path, named = _existing(masks), choice.metadata
        if path.suffix.lower() not in (".json", ".jsonl"):
            return open_maps_at(path, reader, choice)
        categories = read_categories(read_bytes(named), str(named)) if named else None
        return CocoMasks(read_bytes(path), str(path), reader, categories)
    is_one = isinstance(masks, Mapping | bytes) or getattr(masks, "shape", None) == ()
    is_list = isinstance(masks, Sequence) or hasattr(masks, "__array__")
    if is_one or not (is_list or isinstance(masks, Iterable)):
        raise SourceError(
            f"masks of type {type(masks).__name__} are not understood; give a path, instance "
            "maps [T, H, W] or one item per frame"
        )
    masks = masks if is_list else list(masks)
    # The length of a video may be an estimate.
    num_frames = reader.num_entries if isinstance(reader, ItemReader) else None
    convert = functools.partial(detections_from, class_names=class_names)
    return ArrayMasks(masks, convert, num_frames)


def _existing(path: str | Path) -> Path:
    given = as_path(path, "the path", SourceError)
    try:
        resolved = given.expanduser()
        resolved = resolved.resolve() if ".." in resolved.parts else resolved.absolute()
    except (RuntimeError, OSError) as error:  # of a user that there is not; nor a current folder
        raise SourceError(f"'{path}' is no path that can be read: {error}") from error
    if resolved.name.lower().endswith(PACKED):
        raise SourceError(f"'{path}' is packed; unpack it")
    if resolved.exists():
        return resolved
    if resolved.is_symlink():
        raise SourceError(f"'{path}' is a link that leads nowhere; mend it")
    # A path has lost one of the slashes of an address, and may have a password in it.
    if (scheme := re.match(r"(\w\w+):/", str(path))) is not None:
        raise SourceError(
            f"an address ({scheme[1]}:) was given as a path; give it as text, and a live stream "
            "only as a source"
        )
    where = resolved.parent
    if not where.is_dir():
        raise SourceError(f"'{path}' does not exist, nor does the folder '{where}'")
    hint = nearest_names(resolved.name, [p.name for p in where.iterdir()])
    is_close = hint.startswith("did you mean")
    raise SourceError(f"'{path}' does not exist" + (f"; {hint}" if is_close else ""))


def _masks_as_json(masks: Any) -> str | None:
    if masks is None or (isinstance(masks, str) and masks == NO_MASKS):
        return masks
    return str(Path(masks).absolute()) if isinstance(masks, str | Path) else NO_MASKS
