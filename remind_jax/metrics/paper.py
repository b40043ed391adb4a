"""The paper's protocol: the original evaluator's definitions (evaluation.md#paper-protocol).

Letters: `N` detections, `G` observations (a visible object in a frame).
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.collapse import PROVISIONAL_BASE, collapse_published
from remind_jax.metrics.decisions import NO_ROW, Decisions, take_or
from remind_jax.metrics.paper_scores import PaperCounts
from remind_jax.metrics.recovery import (
    ANY_CLASS,
    NO_LABEL,
    Answers,
    count_recovery,
    find_reference,
)
from remind_jax.metrics.sequence import number_ids
from remind_jax.metrics.uncertainty import find_owners, holds_truth, is_owned

_MOSTLY_TRACKED, _MOSTLY_LOST = 0.8, 0.2


@dataclasses.dataclass(frozen=True)
class Sightings:
    """Truth of a scene and every detection in it, matched."""

    gt_frame: Int[np.ndarray, "G"]  # not falling
    gt_id: Int[np.ndarray, "G"]
    gt_class: Int[np.ndarray, "G"]
    frame: Int[np.ndarray, "N"]  # not falling
    row: Int[np.ndarray, "N"]  # observation that the detection shows, NO_ROW without one
    iou: Float[np.ndarray, "N"]
    class_id: Int[np.ndarray, "N"]
    decisions: Decisions  # of N detections

    @cached_property
    def detection(self) -> Int[np.ndarray, "G"]:
        """The detection that shows each observation, NO_ROW without one."""
        of = np.full(len(self.gt_id), NO_ROW)
        shown = self.row != NO_ROW
        of[self.row[shown]] = np.flatnonzero(shown)
        return of

    @cached_property
    def firm_id(self) -> Int[np.ndarray, "N"]:
        """Firm id of each detection, NO_ID without one."""
        return np.where(self.decisions.is_firm, self.decisions.object_id, NO_ID)

    @cached_property
    def firm_label(self) -> Int[np.ndarray, "G"]:
        """Firm id of each observation, NO_ID without one."""
        return take_or(self.firm_id, self.detection, NO_ID)


def count_remind(sightings: Sightings) -> PaperCounts:
    """Counts a run of REMIND as the original does (evaluation.md#paper-protocol)."""
    gt_id, detection = sightings.gt_id, sightings.detection
    collapsed = collapse_scene(sightings)
    label = take_or(collapsed, detection, NO_ID)
    answers = _answers(sightings, label, _label_class(sightings, collapsed))
    answer = _unshared_answers(sightings, collapsed)
    is_right = _carries_reference(answers, answer)
    is_claimed = collapsed != NO_ID
    claims = np.unique(np.stack([sightings.frame, collapsed])[:, is_claimed], axis=1).shape[1]

    owners = find_owners(sightings.gt_frame, gt_id, sightings.firm_label)
    is_first = _is_first(sightings)
    correct = np.where(is_first, label >= PROVISIONAL_BASE, is_owned(label, owners, gt_id))
    said = sightings.decisions.take(detection)
    later_match = (said.outcome == Outcome.MATCH) & ~is_first
    firm_right = (said.outcome == Outcome.NEW) & is_first
    firm_right |= later_match & is_owned(said.object_id, owners, gt_id)
    is_ambiguous = said.outcome == Outcome.AMBIGUOUS
    hits = holds_truth(said.candidate_id[is_ambiguous], owners, gt_id[is_ambiguous])
    return _count(
        sightings,
        answer,
        correct,
        identity_true=is_right.sum(),
        num_answers=claims,
        uncertainty=(
            said.is_firm.sum(),
            firm_right.sum(),
            is_ambiguous.sum(),
            hits.sum(),
            (correct & is_ambiguous).sum(),
        ),
    )


def count_generic(sightings: Sightings) -> PaperCounts:
    """Counts any tracker as the original does for its baselines; firm ids only."""
    answers = _firm_answers(sightings)
    is_right = _carries_reference(answers, answers.label)
    return _count(
        sightings,
        answers.label,
        is_right,
        identity_true=is_right.sum(),
        num_answers=int((answers.label != NO_LABEL).sum()),
        uncertainty=(0, 0, 0, 0, 0),
    )


def collapse_scene(sightings: Sightings) -> Int[np.ndarray, "N"]:
    """The id that every detection is scored with, see `collapse_published`."""
    frame = sightings.frame
    collapsed = np.full(len(frame), NO_ID, np.int64)
    for rows in np.split(np.arange(len(frame)), np.flatnonzero(np.diff(frame)) + 1):
        collapsed[rows] = collapse_published(sightings.decisions.take(rows))
    return collapsed


def _count(
    sightings: Sightings,
    answer: Int[np.ndarray, "G"],
    correct: Bool[np.ndarray, "G"],
    *,
    identity_true: int,
    num_answers: int,
    uncertainty: tuple[int, ...],
) -> PaperCounts:
    objects, index = number_ids(sightings.gt_id)
    share = np.bincount(index, correct, len(objects)) / np.maximum(1, np.bincount(index))
    is_mt, is_ml = share >= _MOSTLY_TRACKED, share <= _MOSTLY_LOST
    firm = _firm_answers(sightings)
    recovery = count_recovery(firm, find_reference(firm))
    counts = (
        len(answer),
        (sightings.detection != NO_ROW).sum(),
        correct.sum(),
        identity_true,
        num_answers - identity_true,
        len(answer) - identity_true,
        *_count_changes(index, sightings.gt_frame, answer),
        is_mt.sum(),
        (~is_mt & ~is_ml).sum(),
        is_ml.sum(),
        recovery.opportunities.sum(),
        recovery.recovered.sum(),
        recovery.hard_recovered.sum(),
        *uncertainty,
    )
    return PaperCounts(*(np.asarray(int(count)) for count in counts))


def _count_changes(
    index: Int[np.ndarray, "G"], frame: Int[np.ndarray, "G"], answer: Int[np.ndarray, "G"]
) -> tuple[int, int]:
    """Switches between successive answers, and interruptions of answered observations."""
    order = np.lexsort((frame, index))
    index, answer = index[order], answer[order]
    is_answered = answer != NO_ID
    who, said = index[is_answered], answer[is_answered]
    switches = int(((who[1:] == who[:-1]) & (said[1:] != said[:-1])).sum())
    follows = np.zeros(len(index), bool)
    follows[1:] = is_answered[:-1] & (index[1:] == index[:-1])
    starts = is_answered & ~follows
    runs = np.bincount(index[starts], minlength=1)
    return switches, int(np.maximum(0, runs - 1).sum())


def _answers(
    sightings: Sightings, label: Int[np.ndarray, "G"], label_class: dict[int, int]
) -> Answers:
    """Labels numbered from 0, with the class of each, for the one-to-one reference."""
    said = label != NO_ID
    names, number = number_ids(label[said])
    numbered = np.full(len(label), NO_LABEL)
    numbered[said] = number
    overlap = take_or(sightings.iou, sightings.detection, 0.0)
    classes = np.array([label_class.get(int(name), ANY_CLASS) for name in names], np.int64)
    return Answers(
        sightings.gt_frame,
        sightings.gt_id,
        numbered,
        np.where(said, overlap, 0.0),
        sightings.gt_class,
        classes,
    )


def _firm_answers(sightings: Sightings) -> Answers:
    return _answers(sightings, sightings.firm_label, _object_class(sightings))


def _carries_reference(answers: Answers, answer: Int[np.ndarray, "G"]) -> Bool[np.ndarray, "G"]:
    """Whether each observation is answered by its object's reference.

    `answer` is `answers.label`, or the same without some answers; other values count as answered.
    """
    reference = find_reference(answers)
    if not len(reference):
        return np.zeros(len(answer), bool)
    expected = reference[np.searchsorted(answers.objects, answers.gt_id)]
    return (answer != NO_LABEL) & (answers.label == expected) & (answers.label != NO_LABEL)


def _unshared_answers(
    sightings: Sightings, collapsed: Int[np.ndarray, "N"]
) -> Int[np.ndarray, "G"]:
    """The collapsed id of each observation, NO_ID where two objects carry it in that frame."""
    shown = np.flatnonzero((collapsed != NO_ID) & (sightings.row != NO_ROW))
    key = np.stack([sightings.frame[shown], collapsed[shown]])
    _, member, count = np.unique(key, axis=1, return_inverse=True, return_counts=True)
    alone = shown[count[member.ravel()] == 1]
    answer = np.full(len(sightings.gt_id), NO_ID, np.int64)
    answer[sightings.row[alone]] = collapsed[alone]
    return answer


def _object_class(sightings: Sightings) -> dict[int, int]:
    """Class of each stored object: that of its first firm detection."""
    firm = np.flatnonzero(sightings.decisions.is_firm)[::-1]
    ids, classes = sightings.firm_id[firm].tolist(), sightings.class_id[firm].tolist()
    return dict(zip(ids, classes, strict=True))


def _label_class(sightings: Sightings, collapsed: Int[np.ndarray, "N"]) -> dict[int, int]:
    """Class of each collapsed id: of the stored object, or for a birth that of its truth."""
    classes = _object_class(sightings)
    born = np.flatnonzero((collapsed >= PROVISIONAL_BASE) & (sightings.row != NO_ROW))[::-1]
    of_truth = sightings.gt_class[sightings.row[born]].tolist()
    return classes | dict(zip(collapsed[born].tolist(), of_truth, strict=True))


def _is_first(sightings: Sightings) -> Bool[np.ndarray, "G"]:
    """Observations in the first frame in which their object is visible."""
    _, index = number_ids(sightings.gt_id)
    first = np.full(index.max(initial=-1) + 1, np.iinfo(np.int64).max)
    np.minimum.at(first, index, sightings.gt_frame)
    return sightings.gt_frame == first[index]
