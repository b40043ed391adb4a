"""Scores on federated truth, in which not every class is labeled in every video (TAO, BURST).

Classes are scored apart and then brought together, over classes or over detections. In a video

* a class that does not occur in a frame is known only if the video says that it is absent:
  predictions of any other class without truth in the frame are left out;
* of a class that is not labeled exhaustively, predictions that match no object are left out;
* classes without truth anywhere, and frames without any truth, are not evaluated.

This is the rule of TrackEval's TAO and BURST, and the numbers equal its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from remind_jax.metrics.combine import average_classes
from remind_jax.metrics.evaluation import (
    Evaluation,
    evaluate_sequence,
    mean_fields,
    pool_classes,
    pool_evaluations,
)
from remind_jax.metrics.formats.rows import UNKNOWN_CLASS, Federation
from remind_jax.metrics.matching import match_detections
from remind_jax.metrics.pairing import PairedScene, class_key
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.printing.small_table import Printable, SmallTable

NO_COMMON_CLASS = (
    "predictions name no class of the truth, which leaves objects unlabeled: "
    "predictions on these count as false positives"
)


_MAIN_SCORES = ("HOTA", "DetA", "AssA", "LocA", "MOTA", "IDF1", "IDP", "IDR")
FEDERATED_HEADS = ("score", "mean of classes", "over detections")  # of `FederatedScores.rows`


@dataclasses.dataclass(frozen=True, repr=False)
class FederatedScores(Printable):
    """Scores of every class with truth, scenes pooled, and of all classes together."""

    by_class: Mapping[str, Evaluation]

    def class_averaged(self) -> dict[str, float]:
        """Ratios averaged over classes, counts added: rare classes weigh as much as others."""
        return mean_fields(average_classes([e.standard_fields() for e in self.by_class.values()]))

    def detection_averaged(self) -> dict[str, float]:
        """Counts of all classes added, then the formulas: detections weigh alike."""
        return mean_fields(pool_evaluations(list(self.by_class.values())).standard_fields())

    def rows(self) -> list[tuple[str, ...]]:
        """The main scores, in percent: name, mean of classes, over detections."""
        averages = self.class_averaged(), self.detection_averaged()
        return [
            (name, *(f"{100 * average[name]:.2f} %" for average in averages))
            for name in _MAIN_SCORES
        ]

    def _summarize(self) -> SmallTable:
        title = f"only what the labels judge, {len(self.by_class)} classes"
        return SmallTable(title, (), FEDERATED_HEADS, self.rows())

    def classes(self) -> dict[str, dict[str, float]]:
        """Scores of each class."""
        return {label: mean_fields(e.standard_fields()) for label, e in self.by_class.items()}


def name_categories(paired: PairedScene) -> TrackingSequence | None:
    """The scene with the truth's categories as classes, UNKNOWN_CLASS for predictions of others.

    Nothing if the truth is not federated, or no prediction is of one of its categories.
    """
    truth, prediction = paired.truth, paired.prediction
    if truth.federation is None:
        return None
    pred_class = prediction.class_id
    if prediction.class_names != truth.class_names:
        place = {class_key(name): index for index, name in enumerate(truth.class_names)}
        found = [place.get(class_key(name), UNKNOWN_CLASS) for name in prediction.class_names]
        pred_class = np.array([*found, UNKNOWN_CLASS])[pred_class]
    if len(pred_class) and (pred_class == UNKNOWN_CLASS).all():
        return None
    return dataclasses.replace(
        paired.sequence,
        gt_class=truth.class_id,
        pred_class=pred_class,
        class_names=truth.class_names,
    )


def evaluate_federated(
    sequence: TrackingSequence, federation: Federation, firm: TrackingSequence | None = None
) -> dict[str, Evaluation]:
    """Scores of each class that has truth or a prediction that counts.

    `sequence` is of `name_categories`; `firm` is the same with firm answers only, for recovery.
    """
    found = np.union1d(sequence.gt_class, sequence.pred_class).tolist()
    evaluations = {}
    for place in sorted(set(found) - {UNKNOWN_CLASS} - federation.unused):
        part = select_labeled(sequence, place, federation)
        if not len(part.gt_id) and not len(part.pred_id):
            continue
        firm_part = None if firm is None else select_labeled(firm, place, federation)
        evaluations[sequence.class_names[place]] = evaluate_sequence(part, firm=firm_part)
    return evaluations


def select_labeled(
    sequence: TrackingSequence, place: int, federation: Federation
) -> TrackingSequence:
    """Truth of one class and those of its predictions that can be judged."""
    is_used = ~np.isin(sequence.gt_class, list(federation.unused))
    has_truth = np.isin(sequence.pred_frame, sequence.gt_frame[is_used])
    part = sequence.select(sequence.gt_class == place, (sequence.pred_class == place) & has_truth)
    is_judged = np.zeros(len(part.pred_id), bool)
    is_judged[match_detections(part)[1]] = True
    if place not in federation.incomplete:
        is_known = np.full(len(part.pred_id), place in federation.absent)
        is_judged |= is_known | (part.gt_counts[part.pred_frame] > 0)
    return part.select(np.ones(len(part.gt_id), bool), is_judged)


def pool_federated(scenes: Sequence[Evaluation]) -> FederatedScores | None:
    """Adds the counts of scenes, class by class; classes without any truth are left out.

    Nothing if no scene was scored as federated.
    """
    pooled = pool_classes([scene.federated for scene in scenes])
    known = {label: e for label, e in sorted(pooled.items()) if e.sizes.gt_rows > 0}
    return FederatedScores(known) if known else None
