"""Masks written as run-length codes or polygons, as COCO and SAM have them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from hotcoco import mask as coco
from jaxtyping import Bool

from remind_jax.errors import SourceError
from remind_jax.files.records import check
from remind_jax.sources.coco_rows import Code, Segmentation, as_rle, say_bad_segmentation
from remind_jax.sources.label_maps import require_same_picture
from remind_jax.sources.source import UnreadableFrame


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
        return decode_sound(checked, frame_size)
    except SourceError as error:
        raise UnreadableFrame(str(error)) from error


def decode_sound(
    segmentation: Segmentation, frame_size: tuple[int, int]
) -> Bool[np.ndarray, "H W"]:
    """Pixels of a segmentation that was found to be sound, by its own size or the frame's."""
    if isinstance(segmentation, Code):
        require_same_picture(segmentation.size, frame_size, "a mask")
        if isinstance(segmentation.counts, str):
            rle = as_rle(segmentation)
        else:
            plain = {"size": list(segmentation.size), "counts": segmentation.counts}
            rle = coco.frPyObjects(plain, *segmentation.size)
    else:
        rle = coco.merge(coco.frPyObjects(segmentation, *frame_size))
    # By columns, as COCO stores them, and then by rows, where OpenCV is quick.
    return np.asarray(cv2.transpose(coco.decode(rle).T), np.uint8).view(bool)
