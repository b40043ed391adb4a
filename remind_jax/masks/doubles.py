"""Second detections of one thing, as detectors have them (host).

Letters: `N` detections, `H W` pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from remind_jax.crops import Crops


def find_doubles(
    masks: Crops, labels: Sequence[str], scores: Float[np.ndarray, "N"], least_overlap: float
) -> Bool[np.ndarray, "N"]:
    """Detections that overlap a better one of their class: two masks of one thing.

    Of equal scores the first is better. From the intersection over union `least_overlap` on two are
    one thing; 0: none is.
    """
    doubles = np.zeros(len(masks), bool)
    if not least_overlap:
        return doubles
    boxes = [masks.box(row) for row in range(len(masks))]
    corner, size = np.split(np.array(boxes, int).reshape(-1, 4), 2, axis=1)
    areas, kept = masks.areas.tolist(), np.zeros(len(masks), bool)
    for row in np.argsort(-np.asarray(scores), kind="stable").tolist():
        meets = np.all((corner < corner[row] + size[row]) & (corner[row] < corner + size), axis=1)
        for better in np.flatnonzero(kept & meets).tolist():
            if labels[row] != labels[better]:
                continue
            # Union at least the larger mask, intersection at most the smaller one.
            least = least_overlap * max(areas[row], areas[better])
            if least == 0 or min(areas[row], areas[better]) < least:
                continue
            shared = _intersection(masks, row, better, boxes)
            if shared >= least_overlap * (areas[row] + areas[better] - shared):
                doubles[row] = True
                break
        else:
            kept[row] = True
    return doubles


def _intersection(masks: Crops, left: int, right: int, boxes: Sequence[Sequence[int]]) -> int:
    """Pixels that two masks share."""
    (x, y, width, height), (u, v, breadth, depth) = boxes[left], boxes[right]
    columns = slice(max(x, u), min(x + width, u + breadth))
    rows = slice(max(y, v), min(y + height, v + depth))
    if columns.start >= columns.stop or rows.start >= rows.stop:
        return 0
    return int(np.sum(masks.region(left, rows, columns) & masks.region(right, rows, columns)))
