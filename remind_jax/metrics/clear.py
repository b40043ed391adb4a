"""CLEAR MOT, as Bernardin and Stiefelhagen 2008 (evaluation.md#clear); values equal TrackEval's."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.metrics.combine import add_counts, map_counts, sum_counts
from remind_jax.metrics.matching import EPSILON, MATCH_THRESHOLD, assign_frame, has_rivals
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


def count_clear(sequence: TrackingSequence) -> ClearCounts:
    """Matches one sequence frame by frame and counts what CLEAR needs."""
    matches = _match_clear(sequence)
    of_objects, rest = _count_by_object(sequence, matches)
    counts = add_counts(sum_counts(of_objects), rest)
    similarity_sum = sequence.pair_similarity[matches].sum()
    return dataclasses.replace(counts, similarity_sum=np.asarray(similarity_sum))


def split_clear(sequence: TrackingSequence) -> tuple[ClearCounts, ClearCounts]:
    """Counts of each object, and what belongs to none; together those of the sequence."""
    return _count_by_object(sequence, _match_clear(sequence))


def _count_by_object(
    sequence: TrackingSequence, matches: Int[np.ndarray, "M"]
) -> tuple[ClearCounts, ClearCounts]:
    lengths = sequence.gt_lengths
    num = len(lengths)
    owner = sequence.gt_index[sequence.pair_gt[matches]]
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
    is_evaluated = len(sequence.gt_id) > 0 and len(sequence.pred_id) > 0
    rest = dataclasses.replace(
        map_counts(lambda values: np.zeros((), np.int64), counts),
        false_positives=np.asarray(len(sequence.pred_id) - len(matches)),
        frames=np.asarray(sequence.num_frames if is_evaluated else 0),
    )
    return counts, rest


def _match_clear(sequence: TrackingSequence) -> Int[np.ndarray, "M"]:
    """The pairs that CLEAR matches, as places in the table of pairs."""
    pairs = np.flatnonzero(sequence.pair_similarity >= MATCH_THRESHOLD - EPSILON)
    return pairs[_match_continuously(sequence, pairs)]


def _processed_order(sequence: TrackingSequence) -> Int[np.ndarray, "T"]:
    """Running number of each frame among those with both ground truth and predictions.

    Only these frames advance the matching: a frame without any prediction cuts no track.
    """
    has_both = (sequence.gt_counts > 0) & (sequence.pred_counts > 0)
    return np.cumsum(has_both) - 1


def _match_continuously(
    sequence: TrackingSequence, pairs: Int[np.ndarray, "C"]
) -> Bool[np.ndarray, "C"]:
    """Chooses among the admitted pairs, keeping the ids of the previous processed frame first.

    A pair that was chosen there outweighs all of its rivals here, and two such pairs are never
    rivals. So only rivals that are left over have to be solved.
    """
    chosen = [True] * len(pairs)
    before = _find_predecessors(sequence, pairs).tolist()
    gt, pred = sequence.pair_gt[pairs].tolist(), sequence.pair_pred[pairs].tolist()
    frames = sequence.pair_frame[pairs]
    rivals = np.flatnonzero(has_rivals(sequence, pairs))

    def is_kept(i: int) -> bool:
        return before[i] >= 0 and chosen[before[i]]

    for group in np.split(rivals, np.flatnonzero(np.diff(frames[rivals])) + 1):
        kept = [i for i in group.tolist() if is_kept(i)]
        gt_kept, pred_kept = {gt[i] for i in kept}, {pred[i] for i in kept}
        left = [i for i in group.tolist() if gt[i] not in gt_kept and pred[i] not in pred_kept]
        for i in group.tolist():
            chosen[i] = i in kept or i in left
        if len({gt[i] for i in left}) < len(left) or len({pred[i] for i in left}) < len(left):
            first, last = np.searchsorted(frames, frames[left[0]] + np.arange(2)).tolist()
            bonus = _CONTINUITY_BONUS * np.asarray([is_kept(i) for i in range(first, last)])
            here = pairs[first:last]
            score = bonus + sequence.pair_similarity[here]
            chosen[first:last] = assign_frame(sequence, int(frames[first]), here, score).tolist()
    return np.asarray(chosen, bool)


def _find_predecessors(
    sequence: TrackingSequence, pairs: Int[np.ndarray, "C"]
) -> Int[np.ndarray, "C"]:
    """Where in `pairs` the same two ids meet in the previous processed frame, -1 if they do not."""
    _, _, id_pair = sequence.id_pairs
    id_pair = id_pair[pairs]
    step = _processed_order(sequence)[sequence.pair_frame[pairs]]
    order = np.argsort(id_pair, kind="stable")  # by frame within a pair of ids
    is_next = (np.diff(id_pair[order]) == 0) & (np.diff(step[order]) == 1)
    before = np.full(len(pairs), -1)
    before[order[1:][is_next]] = order[:-1][is_next]
    return before


def _find_breaks(
    sequence: TrackingSequence, matches: Int[np.ndarray, "M"]
) -> tuple[Bool[np.ndarray, "B"], Bool[np.ndarray, "B"], Int[np.ndarray, "B"]]:
    """Identity switches (across any gap) and fragmentations, and the object of each.

    One entry for every match that follows another, ordered by object and frame.
    """
    objects = sequence.gt_index[sequence.pair_gt[matches]]
    labels = sequence.pred_index[sequence.pair_pred[matches]]
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
