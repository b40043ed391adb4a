"""What formats know of a run: firm identities, each once per frame.

Undecided detections are left out. Where an identity was given twice in a frame (possible with the
published configuration) the detection with the higher score keeps it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.decision import NO_ID
from remind_jax.frame import Rle
from remind_jax.masks.run_length import decode_mask, encode_masks, mask_areas, union_area
from remind_jax.tracks import Tracks


def firm_rows(tracks: Tracks) -> Int[np.ndarray, "K"]:
    """Detections with a firm identity, each identity once."""
    ids = np.where(tracks.is_firm, tracks.object_id, NO_ID)
    return np.flatnonzero(keep_unique(ids, tracks.score))


def firm_ids(tracks: Tracks) -> Int[np.ndarray, "N"]:
    """The firm identity of each detection, each identity once; else NO_ID."""
    ids, rows = np.full(len(tracks), NO_ID, np.int64), firm_rows(tracks)
    ids[rows] = tracks.object_id[rows]
    return ids


def stated_confidence(tracks: Tracks, row: int) -> float:
    """The confidence of a detection; 1 where the tracker rates nothing, as new objects often.

    Scorers leave out what has 0, and rank it last.
    """
    rated = tracks.shown_confidence(row)
    return 1.0 if rated is None else rated


def main_labels(run: Sequence[Tracks], ids: Sequence[Int[np.ndarray, "_"]]) -> dict[int, str]:
    """The class of most detections of each identity, by the identities of every frame."""
    votes: dict[int, Counter[str]] = {}
    for tracks, own in zip(run, ids, strict=True):
        for row in np.flatnonzero(own != NO_ID):
            votes.setdefault(int(own[row]), Counter())[tracks.labels[row]] += 1
    return {one: counted.most_common(1)[0][0] for one, counted in votes.items()}


def keep_unique(ids: Int[np.ndarray, "N"], score: Float[np.ndarray, "N"]) -> Bool[np.ndarray, "N"]:
    """Which detections of a frame keep their id where several have the same one.

    The highest score wins, then the first detection; what has NO_ID is not kept.
    """
    order = np.argsort(-np.asarray(score, float), kind="stable")
    order = order[ids[order] != NO_ID]
    _, first = np.unique(ids[order], return_index=True)
    keep = np.zeros(len(ids), bool)
    keep[order[first]] = True
    return keep


def masks_without_overlap(tracks: Tracks, rows: Int[np.ndarray, "K"]) -> list[Rle | None]:
    """The masks of `rows` without shared pixels; None for one of which nothing is left."""
    rles = [tracks.rles[row] for row in rows]
    areas = mask_areas(rles)
    if union_area(rles) == areas.sum():
        return [rle if area else None for rle, area in zip(rles, areas, strict=True)]
    taken: Bool[np.ndarray, "H W"] = np.zeros(tracks.frame_size, bool)
    cut: list[Rle | None] = [None] * len(rles)
    confidence = np.array([stated_confidence(tracks, row) for row in rows])
    for place in np.argsort(-confidence, kind="stable"):
        free = decode_mask(rles[place]).astype(bool) & ~taken
        taken |= free
        if free.any():
            (cut[place],) = encode_masks(free[None])
    return cut
