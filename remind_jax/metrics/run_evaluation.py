"""Scores a paired scene, with the decisions of a run if it has any (evaluation.md#uncertainty).

Undecided detections are `strict`, without an id, or settled together in a frame: `collapse`.
Letters: `D` detections of a run, `N` observations.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Bool, Int

from remind_jax.decision import NO_ID
from remind_jax.errors import RemindError, SourceError, nearest_names
from remind_jax.formats.firm import keep_unique
from remind_jax.frame import NO_INSTANCE
from remind_jax.metrics.collapse import collapse_frame
from remind_jax.metrics.decisions import NO_ROW, Decisions
from remind_jax.metrics.evaluation import Evaluation, evaluate_classes, evaluate_sequence
from remind_jax.metrics.matching import match_detections
from remind_jax.metrics.pairing import PairedScene
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.uncertainty import UncertaintyCounts, count_uncertainty
from remind_jax.tracks import Tracks

Undecided = Literal["strict", "collapse"]


@dataclasses.dataclass(frozen=True)
class Labels:
    """Ids of the detections of a run, by one way to deal with undecided ones."""

    ids: Int[np.ndarray, "D"]  # NO_ID without one
    is_kept: Bool[np.ndarray, "D"]  # has an id that no better detection of the frame has too

    @classmethod
    def create(cls, tracks: Sequence[Tracks], undecided: Undecided) -> Labels:
        """Names the detections of every frame."""
        parts = [(np.zeros(0, np.int64), np.zeros(0, bool))]
        for frame in tracks:
            decisions = Decisions.of_tracks([frame])
            ids = collapse_frame(decisions) if undecided == "collapse" else decisions.object_id
            parts.append((ids.astype(np.int64), keep_unique(ids, frame.score)))
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    @property
    def num_repeated(self) -> int:
        """Ids taken back because a better detection of the frame has them."""
        return int((self.ids != NO_ID).sum() - self.is_kept.sum())

    def apply(self, sequence: TrackingSequence) -> TrackingSequence:
        """The sequence of numbered detections with only those that keep an id, under their ids."""
        everything = np.ones(len(sequence.gt), bool)
        kept = sequence.select(everything, self.is_kept[sequence.pred.id])
        named = dataclasses.replace(kept.pred, id=self.ids[kept.pred.id])
        return dataclasses.replace(kept, pred=named)


def evaluate_tracks(
    tracks: Iterable[Tracks],
    *,
    undecided: Undecided = "strict",
    by_class: bool = False,
    min_absence_frames: int = 1,
    name: str = "run",
) -> Evaluation:
    """Scores a run whose detections carry their true instance (`Tracks.instance_ids`).

    A detection with a known instance is that object, exactly; a firm id on any other is a false
    positive. If a frame gives one id to several detections, the best-scored keeps it, the others
    count as missed, and `RepeatedIDs` says how many.

    Raises:
      SourceError: If no detection has a true instance, an instance occurs twice in a frame, or
        frames are not in order.
      RemindError: If `undecided` is neither of the two.
    """
    check_undecided(undecided)
    frames = list(tracks)
    return evaluate_pair(
        pair_with_instances(frames, name),
        frames,
        undecided=undecided,
        by_class=by_class,
        min_absence_frames=min_absence_frames,
    )


def evaluate_pair(
    paired: PairedScene,
    tracks: Sequence[Tracks] | None,
    *,
    undecided: Undecided,
    by_class: bool = False,
    min_absence_frames: int = 1,
) -> Evaluation:
    """Scores a paired scene."""
    firm = None if tracks is None else Labels.create(tracks, "strict")
    chosen = firm if tracks is None or undecided == "strict" else Labels.create(tracks, undecided)
    numbered = paired.sequence
    sequence = numbered if chosen is None else chosen.apply(numbered)
    firm_sequence = None if firm is None or firm is chosen else firm.apply(numbered)
    evaluation = evaluate_sequence(
        sequence,
        firm=firm_sequence,
        uncertainty=None if tracks is None else _judge(numbered, tracks),
        num_repeated=0 if chosen is None else chosen.num_repeated,
        min_absence_frames=min_absence_frames,
    )
    if by_class:
        classes = evaluate_classes(sequence, firm_sequence, min_absence_frames)
        evaluation = dataclasses.replace(evaluation, by_class=classes)
    return evaluation


def check_undecided(undecided: str) -> None:
    """Raises RemindError if it is no way to deal with undecided detections."""
    if undecided not in ("strict", "collapse"):
        hint = nearest_names(undecided, ("strict", "collapse"))
        raise RemindError(f"undecided is '{undecided}'; {hint}")


def pair_with_instances(tracks: Sequence[Tracks], name: str) -> PairedScene:
    """Numbered detections and the instances that they are.

    Raises:
      SourceError: If there are no instances, or frames are not in order.
    """
    for before, after in itertools.pairwise(tracks):
        if after.frame_index <= before.frame_index:
            raise SourceError(
                f"{name}: frame {after.frame_index} follows frame {before.frame_index}; give "
                "frames in order"
            )
    class_names = sorted({label for frame in tracks for label in frame.labels}) or ["object"]
    place = {label: index for index, label in enumerate(class_names)}
    empty = np.zeros(0, np.int64)
    columns = [(empty, empty, empty)] + [
        (
            np.full(len(frame), frame.frame_index),
            np.asarray(frame.instance_ids, np.int64),
            np.array([place[label] for label in frame.labels], np.int64),
        )
        for frame in tracks
    ]
    frame, instance, class_id = (np.concatenate(column) for column in zip(*columns, strict=True))
    is_object = instance != NO_INSTANCE
    if len(instance) and not is_object.any():
        raise SourceError(
            f"{name}: no detection has a true instance id, so there is nothing to compare with; "
            "give masks with instance ids, or evaluate files against a ground-truth file"
        )
    numbers = np.arange(len(instance))
    num_frames = tracks[-1].frame_index + 1 if tracks else 0
    shown = numbers[is_object]
    sequence = TrackingSequence.create(
        num_frames,
        (frame[shown], instance[shown]),
        (frame, numbers),
        (np.arange(len(shown)), shown, np.ones(len(shown))),
        gt_class=class_id[shown],
        pred_class=class_id,
        class_names=class_names,
        name=name,
    )
    return PairedScene(sequence)


def _judge(sequence: TrackingSequence, tracks: Sequence[Tracks]) -> UncertaintyCounts:
    """Counts undecided answers by the numbered detection that shows each observation."""
    gt, pred, _ = match_detections(sequence)
    number = np.full(len(sequence.gt), NO_ROW)
    number[gt] = sequence.pred.id[pred]
    decisions = Decisions.of_tracks(tracks).take(number)
    return count_uncertainty(sequence.gt.frame, sequence.gt.id, decisions)
