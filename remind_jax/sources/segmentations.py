"""Masks written as run-length codes or polygons, as COCO and SAM have them."""

from __future__ import annotations

from typing import Any

import numpy as np
from hotcoco import mask as coco
from jaxtyping import Bool

from remind_jax.crops import Crops, cut_plane, cut_runs
from remind_jax.errors import SourceError
from remind_jax.files.records import check
from remind_jax.frame import Rle
from remind_jax.masks.run_length import read_runs
from remind_jax.sources.coco_rows import Segmentation, as_rle, say_bad_segmentation
from remind_jax.sources.label_maps import require_same_picture
from remind_jax.sources.source import UnreadableFrame

_FEW_PIXELS = 1 << 21  # of a larger picture only the runs are looked at


def decode_segmentation(segmentation: Any, frame_size: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
    """Decodes a COCO segmentation: compressed or plain run-length code, or polygons.

    Raises:
      UnreadableFrame: If it is malformed, or of another picture.
    """
    try:
        checked = check(segmentation, Segmentation, "a segmentation")  # pyright: ignore[reportArgumentType]
        why = say_bad_segmentation(checked)
        if why:
            raise SourceError(f"a segmentation: {why}")
        return cut_sound(checked, frame_size).plane(0)
    except SourceError as error:
        raise UnreadableFrame(str(error)) from error


def cut_sound(segmentation: Segmentation, frame_size: tuple[int, int]) -> Crops:
    """The mask of a segmentation that was found to be sound, by its own size or the frame's.

    Raises:
      SourceError: If it is of another picture.
    """
    if isinstance(segmentation, list):
        return _cut_code(coco.merge(coco.frPyObjects(segmentation, *frame_size)), frame_size)
    require_same_picture(segmentation.size, frame_size, "a mask")
    if isinstance(segmentation.counts, str):
        return _cut_code(as_rle(segmentation), segmentation.size)
    plain = {"size": list(segmentation.size), "counts": segmentation.counts}
    return _cut_code(coco.frPyObjects(plain, *segmentation.size), segmentation.size)


def _cut_code(rle: Rle, size: tuple[int, int]) -> Crops:
    if size[0] * size[1] <= _FEW_PIXELS:
        corner, window = cut_plane(coco.decode(rle).view(bool))
    else:
        corner, window = cut_runs(read_runs(rle), size[0])
    return Crops(size, (corner,), (window,))
