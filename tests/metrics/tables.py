"""Hand-made sequences: who is where, written as one text line per object."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from remind_jax.metrics.clear import ClearCounts, split_clear
from remind_jax.metrics.combine import total_counts
from remind_jax.metrics.hota import HotaCounts, match_hota, split_hota
from remind_jax.metrics.identity import IdentityCounts, count_right
from remind_jax.metrics.sequence import TrackingSequence


def count_hota(sequence: TrackingSequence) -> HotaCounts:
    return total_counts(*split_hota(sequence, match_hota(sequence)))


def count_clear(sequence: TrackingSequence) -> ClearCounts:
    return total_counts(*split_clear(sequence))


def count_identity(sequence: TrackingSequence) -> IdentityCounts:
    right = int(count_right(sequence).sum())
    wrong = len(sequence.gt) - right, len(sequence.pred) - right
    return IdentityCounts(*map(np.asarray, (right, *wrong)))


def from_frames(
    gt_ids: Sequence[Any], pred_ids: Sequence[Any], similarities: Sequence[Any]
) -> TrackingSequence:
    """One entry per frame; similarities are matrices `[ground truth, predictions]`."""
    rows = {}
    for side, ids in (("gt", gt_ids), ("pred", pred_ids)):
        counts = [len(entry) for entry in ids]
        rows[side] = np.repeat(np.arange(len(ids)), counts), [i for entry in ids for i in entry]
    pairs = []
    for frame, matrix in enumerate(similarities):
        matrix = np.asarray(matrix, float).reshape(len(gt_ids[frame]), len(pred_ids[frame]))
        row, column = np.nonzero(matrix)
        first, first_pred = (np.searchsorted(rows[side][0], frame) for side in ("gt", "pred"))
        pairs.append((row + first, column + first_pred, matrix[row, column]))
    joined = tuple(np.concatenate(part) for part in zip(*pairs, strict=True))
    return TrackingSequence.create(len(gt_ids), rows["gt"], rows["pred"], joined)


def sequence_from_answers(*lines: str) -> TrackingSequence:
    """One line per object, one character per frame.

    A letter is what the object was called, `?` is visible without answer, `.` is out of view.
    Overlaps are perfect.
    """
    gt, pred, matrices = [], [], []
    for called in zip(*lines, strict=True):
        seen = [number for number, one in enumerate(called) if one != "."]
        answered = [number for number in seen if called[number] != "?"]
        gt.append(seen)
        pred.append([ord(called[number]) for number in answered])
        matrices.append(np.equal.outer(seen, answered).astype(float))
    return from_frames(gt, pred, matrices)


def random_sequence(seed: int) -> TrackingSequence:
    """Partly overlapping, partly wrong predictions without exact ties."""
    rng, num_frames, num_objects = np.random.default_rng(seed), 12, 5
    gt, pred, matrices = [], [], []
    for _ in range(num_frames):
        objects = np.flatnonzero(rng.random(num_objects) < 0.8)
        labels = rng.permutation(num_objects + 2)[: rng.integers(0, num_objects + 2)]
        overlap = rng.random((len(objects), len(labels)))
        overlap *= rng.random(overlap.shape) < 0.6
        overlap[objects[:, None] == labels[None]] **= 0.2
        gt.append(objects)
        pred.append(labels)
        matrices.append(overlap)
    return from_frames(gt, pred, matrices)
