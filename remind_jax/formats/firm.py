"""What formats know of a run: firm identities, each once per frame.

Undecided detections are left out. Where an identity was given twice in a frame (possible with the
published configuration) the detection with the higher score keeps it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int

from remind_jax.decision import NO_ID
from remind_jax.frame import Rle
from remind_jax.masks.run_length import decode_mask, encode_masks, mask_areas, union_area
from remind_jax.tracks import Tracks


def firm_rows(tracks: Tracks) -> Int[np.ndarray, "K"]:
    """Detections with a firm identity, each identity once (higher score, then lower row)."""
    rows = np.flatnonzero(tracks.is_firm & (tracks.object_id != NO_ID))
    by_score = rows[np.argsort(-tracks.score[rows], kind="stable")]
    _, first = np.unique(tracks.object_id[by_score], return_index=True)
    return np.sort(by_score[first])


def masks_without_overlap(tracks: Tracks, rows: Int[np.ndarray, "K"]) -> list[Rle | None]:
    """The masks of `rows` without shared pixels; None for one of which nothing is left."""
    rles = [tracks.rles[row] for row in rows]
    areas = mask_areas(rles)
    if union_area(rles) == areas.sum():
        return [rle if area else None for rle, area in zip(rles, areas, strict=True)]
    taken: Bool[np.ndarray, "H W"] = np.zeros(tracks.frame_size, bool)
    cut: list[Rle | None] = [None] * len(rles)
    for place in np.argsort(-tracks.confidence[rows], kind="stable"):
        free = decode_mask(rles[place]).astype(bool) & ~taken
        taken |= free
        if free.any():
            (cut[place],) = encode_masks(free[None])
    return cut
