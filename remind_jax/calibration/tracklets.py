"""Which detections certainly show one object, without labels: boxes that overlap over time.

Letters: `T` frames, `N` detection slots.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

NONE = -1
LEAST_OVERLAP = 0.3  # of the boxes in two successive frames


def link_boxes(
    boxes: Float[np.ndarray, "T N 4"],
    valid: Bool[np.ndarray, "T N"],
    class_id: Int[np.ndarray, "T N"],
) -> Int[np.ndarray, "T N"]:
    """Numbers tracklets; -1 where there is no detection.

    A detection goes on with the one of the frame before that overlaps it most, if that overlaps no
    other more, by `LEAST_OVERLAP` of the union at least, and is of its class.
    """
    found = np.full(valid.shape, NONE, np.int32)
    number = 0
    for t in range(len(valid)):
        if t:
            overlap = overlaps(boxes[t - 1], boxes[t])
            overlap *= valid[t - 1][:, None] & valid[t]
            overlap *= class_id[t - 1][:, None] == class_id[t]
            for slot in np.flatnonzero(valid[t]):
                before = int(overlap[:, slot].argmax()) if len(overlap) else 0
                best = overlap[before, slot]
                if best >= LEAST_OVERLAP and overlap[before].argmax() == slot:
                    found[t, slot] = found[t - 1, before]
        fresh = valid[t] & (found[t] == NONE)
        found[t, fresh] = number + np.arange(int(fresh.sum()))
        number += int(fresh.sum())
    return found


def overlaps(
    first: Float[np.ndarray, "N 4"], second: Float[np.ndarray, "M 4"]
) -> Float[np.ndarray, "N M"]:
    """Intersection over union of all pairs of boxes (left, top, right, bottom)."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    shared = np.prod(np.clip(high - low, 0, None), axis=-1)
    sizes = [np.prod(boxes[:, 2:] - boxes[:, :2], axis=-1) for boxes in (first, second)]
    return shared / np.maximum(sizes[0][:, None] + sizes[1] - shared, 1e-9)
