"""HOTA over 19 thresholds, as Luiten et al. 2021 (evaluation.md#hota); values equal TrackEval's."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from remind_jax.metrics.matching import EPSILON, match_frames
from remind_jax.metrics.sequence import TrackingSequence

# Computed as TrackEval does: a similarity on a threshold must meet the same rounding.
ALPHAS: Float[np.ndarray, "19"] = np.arange(0.05, 0.99, 0.05)

# Keeps LocA at 1 where nothing was matched.
_LOC_FLOOR = 1e-10


@dataclasses.dataclass(frozen=True)
class HotaCounts:
    """What HOTA sums over frames, per threshold; counts of several sequences add up.

    All fields may have leading axes (sequences, resamples).
    """

    true_positives: Float[np.ndarray, "*batch 19"]
    false_negatives: Float[np.ndarray, "*batch 19"]
    false_positives: Float[np.ndarray, "*batch 19"]
    similarity_sum: Float[np.ndarray, "*batch 19"]  # over matches
    association_sum: Float[np.ndarray, "*batch 19"]  # association accuracy over matches
    association_recall_sum: Float[np.ndarray, "*batch 19"]
    association_precision_sum: Float[np.ndarray, "*batch 19"]


def split_hota(
    sequence: TrackingSequence, chosen: Bool[np.ndarray, "K"]
) -> tuple[HotaCounts, HotaCounts]:
    """Counts of each object, and what belongs to none; together those of the sequence.

    `chosen` are the pairs of `match_hota`.
    """
    num = len(sequence.gt.objects)
    object_of, _, _ = sequence.id_pairs
    similarity = sequence.pair_similarity[chosen]
    owner = sequence.gt.index[sequence.pair_gt[chosen]]
    claimed = np.bincount(owner, minlength=num)
    fields = np.zeros((7, num, len(ALPHAS)))
    for at, (is_match, shares) in enumerate(_associate(sequence, chosen)):
        found = np.bincount(owner[is_match], minlength=num)
        fields[:, :, at] = (
            found,
            sequence.gt.lengths - found,
            claimed - found,
            np.bincount(owner[is_match], similarity[is_match], num),
            *(np.bincount(object_of, share, num) for share in shares),
        )
    rest = HotaCounts(*np.zeros((7, len(ALPHAS))))
    rest.false_positives[:] = len(sequence.pred) - claimed.sum()
    return HotaCounts(*fields), rest


def _associate(
    sequence: TrackingSequence, chosen: Bool[np.ndarray, "K"]
) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
    """By threshold: which chosen pairs match, and the shares of each pair of ids.

    Shares are those of association accuracy, recall and precision, times the matches.
    """
    object_of, label_of, id_pair = sequence.id_pairs
    gt_lengths, pred_lengths = sequence.gt.lengths[object_of], sequence.pred.lengths[label_of]
    similarity, id_pair = sequence.pair_similarity[chosen], id_pair[chosen]
    for alpha in ALPHAS:
        is_match = similarity >= alpha - EPSILON
        matches = np.bincount(id_pair[is_match], minlength=len(object_of))
        unions = (gt_lengths + pred_lengths - matches, gt_lengths, pred_lengths)
        yield is_match, [matches * (matches / np.maximum(1, u)) for u in unions]


def match_hota(sequence: TrackingSequence) -> Bool[np.ndarray, "K"]:
    """The pairs that HOTA looks at: in every frame those that fit best over the whole sequence."""
    _, _, id_pair = sequence.id_pairs
    return match_frames(sequence, _align_ids(sequence)[id_pair] * sequence.pair_similarity)


def _align_ids(sequence: TrackingSequence) -> Float[np.ndarray, "I"]:
    """How well each pair of ids fits over the whole sequence, all frames at once."""
    gt, pred, similarity = sequence.pair_gt, sequence.pair_pred, sequence.pair_similarity
    gt_total = np.bincount(gt, similarity, len(sequence.gt))
    pred_total = np.bincount(pred, similarity, len(sequence.pred))
    soft_union = gt_total[gt] + pred_total[pred] - similarity
    share = np.where(soft_union > EPSILON, similarity / np.maximum(soft_union, EPSILON), 0.0)
    object_of, label_of, id_pair = sequence.id_pairs
    common = np.bincount(id_pair, share, len(object_of))
    union = sequence.gt.lengths[object_of] + sequence.pred.lengths[label_of] - common
    return common / union


def hota_scores(counts: HotaCounts) -> dict[str, Any]:
    """HOTA fields under TrackEval's names, from the counts of one or of many sequences.

    Returns:
      Arrays over the 19 thresholds; the usual headline numbers are their means. `HOTA(0)`,
      `LocA(0)`, `HOTALocA(0)` are values at the lowest threshold.
    """
    tp, fn, fp = counts.true_positives, counts.false_negatives, counts.false_positives
    detections = np.maximum(1, tp + fn + fp)
    matched = np.maximum(1, tp)
    recall = tp / np.maximum(1, tp + fn)
    scores = {
        "DetA": tp / detections,
        "AssA": counts.association_sum / matched,
        "DetRe": recall,
        "DetPr": tp / np.maximum(1, tp + fp),
        "AssRe": counts.association_recall_sum / matched,
        "AssPr": counts.association_precision_sum / matched,
        "LocA": np.maximum(_LOC_FLOOR, counts.similarity_sum) / np.maximum(_LOC_FLOOR, tp),
        "HOTA_TP": tp,
        "HOTA_FN": fn,
        "HOTA_FP": fp,
    }
    scores["HOTA"] = np.sqrt(scores["DetA"] * scores["AssA"])
    scores["OWTA"] = np.sqrt(recall * scores["AssA"])
    scores["HOTA(0)"] = scores["HOTA"][..., 0]
    scores["LocA(0)"] = scores["LocA"][..., 0]
    scores["HOTALocA(0)"] = scores["HOTA(0)"] * scores["LocA(0)"]
    return scores
