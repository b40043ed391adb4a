"""CLEAR MOT, as Bernardin and Stiefelhagen 2008 (evaluation.md#clear); values equal TrackEval's."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.metrics.combine import map_counts
from remind_jax.metrics.matching import EPSILON, MATCH_THRESHOLD, assign_frame, split_frames
from remind_jax.metrics.sequence import TrackingSequence

MOSTLY_TRACKED = 0.8  # above: MT
MOSTLY_LOST = 0.2  # below: ML

# Worth of keeping the id of the previous frame; any similarity is less.
_CONTINUITY_BONUS = 1000.0


@dataclasses.dataclass(frozen=True)
class ClearCounts:
    """What CLEAR sums; counts of several sequences add up."""

    true_positives: Float[np.ndarray, "*batch"]
    false_negatives: Float[np.ndarray, "*batch"]
    false_positives: Float[np.ndarray, "*batch"]
    switches: Float[np.ndarray, "*batch"]
    fragments: Float[np.ndarray, "*batch"]
    mostly_tracked: Float[np.ndarray, "*batch"]  # objects
    partly_tracked: Float[np.ndarray, "*batch"]
    mostly_lost: Float[np.ndarray, "*batch"]
    similarity_sum: Float[np.ndarray, "*batch"]  # over matches
    frames: Float[np.ndarray, "*batch"]  # 0 if ground truth or predictions are empty


def split_clear(sequence: TrackingSequence) -> tuple[ClearCounts, ClearCounts]:
    """Counts of each object, and what belongs to none; together those of the sequence."""
    matches = _match_clear(sequence)
    lengths = sequence.gt.lengths
    num = len(lengths)
    owner = sequence.gt.index[sequence.pair_gt[matches]]
    is_switch, is_break, of_break = _find_breaks(sequence, matches)
    found = np.bincount(owner, minlength=num)
    tracked = found / np.maximum(1, lengths)
    is_mt, is_ml = tracked > MOSTLY_TRACKED, tracked < MOSTLY_LOST
    nothing = np.zeros(num, np.int64)
    counts = ClearCounts(
        true_positives=found,
        false_negatives=lengths - found,
        false_positives=nothing,
        switches=np.bincount(of_break[is_switch], minlength=num),
        fragments=np.bincount(of_break[is_break], minlength=num),
        mostly_tracked=is_mt.astype(int),
        partly_tracked=(~is_mt & ~is_ml).astype(int),
        mostly_lost=is_ml.astype(int),
        similarity_sum=np.bincount(owner, sequence.pair_similarity[matches], num),
        frames=nothing,
    )
    is_evaluated = len(sequence.gt) > 0 and len(sequence.pred) > 0
    rest = dataclasses.replace(
        map_counts(lambda values: np.zeros((), np.int64), counts),
        false_positives=np.asarray(len(sequence.pred) - len(matches)),
        frames=np.asarray(sequence.num_frames if is_evaluated else 0),
    )
    return counts, rest


def _match_clear(sequence: TrackingSequence) -> Int[np.ndarray, "M"]:
    """The pairs that CLEAR matches, as places in the table of pairs.

    Ids that were matched in the processed frame before go first.
    """
    _, _, id_pair = sequence.id_pairs
    step, similarity = _processed_order(sequence), sequence.pair_similarity
    matches = [np.zeros(0, np.int64)]
    last, kept = -1, set[int]()
    for frame, pairs in split_frames(
        sequence, np.flatnonzero(similarity >= MATCH_THRESHOLD - EPSILON)
    ):
        follows = step[frame] == last + 1
        bonus = [_CONTINUITY_BONUS * (follows and one in kept) for one in id_pair[pairs].tolist()]
        score = np.asarray(bonus) + similarity[pairs]
        matches.append(pairs[assign_frame(sequence, frame, pairs, score)])
        last, kept = step[frame], set(id_pair[matches[-1]].tolist())
    return np.concatenate(matches)


def _processed_order(sequence: TrackingSequence) -> Int[np.ndarray, "T"]:
    """Running number of each frame among those with both ground truth and predictions.

    Only these frames advance the matching: a frame without any prediction cuts no track.
    """
    has_both = (sequence.gt.counts > 0) & (sequence.pred.counts > 0)
    return np.cumsum(has_both) - 1


def _find_breaks(
    sequence: TrackingSequence, matches: Int[np.ndarray, "M"]
) -> tuple[Bool[np.ndarray, "B"], Bool[np.ndarray, "B"], Int[np.ndarray, "B"]]:
    """Identity switches (across any gap) and fragmentations, and the object of each.

    One entry for every match that follows another, ordered by object and frame.
    """
    objects = sequence.gt.index[sequence.pair_gt[matches]]
    labels = sequence.pred.index[sequence.pair_pred[matches]]
    frame = sequence.pair_frame[matches]
    order = np.lexsort((frame, objects))
    step = _processed_order(sequence)[frame[order]]
    objects, labels = objects[order], labels[order]
    is_same_object = objects[1:] == objects[:-1]
    is_switch = is_same_object & (labels[1:] != labels[:-1])
    is_break = is_same_object & (step[1:] != step[:-1] + 1)
    return is_switch, is_break, objects[1:]


def clear_scores(counts: ClearCounts, *, pooled: bool = False) -> dict[str, Any]:
    """CLEAR fields under TrackEval's names.

    Args:
      pooled: Whether the counts are a sum. TrackEval gives a single sequence without ground truth
        zero ratios (and `MLR` 1), but applies the formulas to sums, which makes `MOTA` negative.
    """
    tp, fn, fp = counts.true_positives, counts.false_negatives, counts.false_positives
    switches, frames = counts.switches, counts.frames
    similarity_sum = counts.similarity_sum
    gt = np.maximum(1.0, tp + fn)
    objects = counts.mostly_tracked + counts.partly_tracked + counts.mostly_lost
    num_objects = np.maximum(1.0, objects)
    log_switches = np.log10(np.maximum(1, switches))
    ratios = {
        "MOTA": (tp - fp - switches) / gt,
        "MOTP": similarity_sum / np.maximum(1.0, tp),
        "MODA": (tp - fp) / gt,
        "CLR_Re": tp / gt,
        "CLR_Pr": tp / np.maximum(1.0, tp + fp),
        "MTR": counts.mostly_tracked / num_objects,
        "PTR": counts.partly_tracked / num_objects,
        "MLR": counts.mostly_lost / num_objects,
        "sMOTA": (similarity_sum - fp - switches) / gt,
        "CLR_F1": tp / np.maximum(1.0, tp + 0.5 * fn + 0.5 * fp),
        "FP_per_frame": fp / np.maximum(1.0, frames),
        "MOTAL": (tp - fp - log_switches) / gt,
    }
    if not pooled:
        has_truth = objects > 0
        ratios = {name: np.where(has_truth, value, 0.0) for name, value in ratios.items()}
        ratios["MLR"] = np.where(has_truth, ratios["MLR"], 1.0)
    return ratios | {
        "MOTP_sum": similarity_sum,
        "CLR_TP": tp,
        "CLR_FN": fn,
        "CLR_FP": fp,
        "IDSW": switches,
        "MT": counts.mostly_tracked,
        "PT": counts.partly_tracked,
        "ML": counts.mostly_lost,
        "Frag": counts.fragments,
        "CLR_Frames": frames,
    }
