"""The paper's protocol: the original evaluator's definitions, where a published number rests on it.

They are not the standard ones of the same names. `paper_scores` says in which
ways, for the two paths of the original: one for REMIND, one for every other tracker. Numbers of the
two do not compare. Rules: evaluation.md#paper-protocol.

Letters: `N` detections, `C` candidates, `G` observations (a visible object in a frame).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.paper_collapse import PROVISIONAL_BASE, Collapse, collapse_published
from remind_jax.metrics.paper_scores import PaperCounts
from remind_jax.metrics.recovery import (
    ANY_CLASS,
    NO_LABEL,
    Answers,
    RecoveryCounts,
    count_recovery,
    find_reference,
)
from remind_jax.metrics.sequence import number_ids
from remind_jax.metrics.uncertainty import FIRM, find_owners

NO_OBJECT = -1

_MOSTLY_TRACKED, _MOSTLY_LOST = 0.8, 0.2


@dataclasses.dataclass(frozen=True)
class Sightings:
    """Truth of a scene and every detection in it, matched."""

    gt_frame: Int[np.ndarray, "G"]  # not falling
    gt_id: Int[np.ndarray, "G"]
    gt_class: Int[np.ndarray, "G"]
    frame: Int[np.ndarray, "N"]  # not falling
    row: Int[np.ndarray, "N"]  # observation that the detection shows, NO_OBJECT without one
    iou: Float[np.ndarray, "N"]
    class_id: Int[np.ndarray, "N"]
    outcome: Int[np.ndarray, "N"]
    object_id: Int[np.ndarray, "N"]  # firm id, else NO_ID
    pending_id: Int[np.ndarray, "N"]
    candidate_id: Int[np.ndarray, "N C"]
    candidate_score: Float[np.ndarray, "N C"]

    @property
    def is_firm(self) -> Bool[np.ndarray, "N"]:
        """Detections with one identity."""
        return np.isin(self.outcome, FIRM) & (self.object_id != NO_ID)

    @property
    def detection(self) -> Int[np.ndarray, "G"]:
        """The detection that shows each observation, NO_OBJECT without one."""
        of = np.full(len(self.gt_id), NO_OBJECT)
        shown = self.row != NO_OBJECT
        of[self.row[shown]] = np.flatnonzero(shown)
        return of


def count_remind(sightings: Sightings, collapse: Collapse = "hungarian") -> PaperCounts:
    """Counts a run of REMIND as the original does (evaluation.md#paper-protocol)."""
    collapsed = collapse_scene(sightings, collapse)
    detection = sightings.detection
    seen = detection != NO_OBJECT
    label = np.full(len(detection), NO_ID)
    label[seen] = collapsed[detection[seen]]
    answers = _answers(sightings, label, _label_class(sightings, collapsed))
    answer = _unshared_answers(sightings, collapsed)
    is_right = _carries_reference(answers, answer)

    is_claimed = collapsed != NO_ID
    claims = np.unique(np.stack([sightings.frame, collapsed])[:, is_claimed], axis=1).shape[1]
    idtp = int(is_right.sum())

    owners = _owners(sightings)
    is_first = _is_first(sightings)
    correct = np.where(is_first, label >= PROVISIONAL_BASE, _owned(label, owners, sightings.gt_id))
    firm = _of_detection(sightings, sightings.is_firm, False)
    outcome = _of_detection(sightings, sightings.outcome, int(Outcome.EMPTY))
    firm_id = _of_detection(sightings, sightings.object_id, NO_ID)
    later_match = (outcome == Outcome.MATCH) & ~is_first
    firm_right = (outcome == Outcome.NEW) & is_first
    firm_right |= later_match & _owned(firm_id, owners, sightings.gt_id)
    is_ambiguous = outcome == Outcome.AMBIGUOUS
    return _count(
        sightings,
        answer,
        correct,
        matched=seen,
        identity=(idtp, claims - idtp, len(label) - idtp),
        recovery=_count_returns(sightings),
        uncertainty=(
            firm.sum(),
            firm_right.sum(),
            is_ambiguous.sum(),
            _count_hits(sightings, detection[is_ambiguous], is_ambiguous, owners),
            (correct & is_ambiguous).sum(),
        ),
    )


def count_generic(sightings: Sightings) -> PaperCounts:
    """Counts any tracker as the original does for its baselines; firm ids only."""
    answers = _firm_answers(sightings)
    label = answers.label
    is_right = _carries_reference(answers, label)
    num_answered = int((label != NO_LABEL).sum())
    idtp = int(is_right.sum())
    seen = sightings.detection != NO_OBJECT
    return _count(
        sightings,
        label,
        is_right,
        matched=seen,
        identity=(idtp, num_answered - idtp, len(label) - idtp),
        recovery=_count_returns(sightings),
        uncertainty=(0, 0, 0, 0, 0),
    )


def collapse_scene(sightings: Sightings, method: Collapse = "hungarian") -> Int[np.ndarray, "N"]:
    """The id that every detection is scored with, see `paper_collapse`."""
    collapsed = np.full(len(sightings.frame), NO_ID, np.int64)
    strength = np.where(sightings.row == NO_OBJECT, -1.0, sightings.iou)
    for rows in np.split(
        np.arange(len(sightings.frame)), np.flatnonzero(np.diff(sightings.frame)) + 1
    ):
        collapsed[rows] = collapse_published(
            sightings.outcome[rows],
            sightings.object_id[rows],
            sightings.pending_id[rows],
            sightings.candidate_id[rows],
            sightings.candidate_score[rows],
            strength[rows],
            method,
        )
    return collapsed


def _count(
    sightings: Sightings,
    answer: Int[np.ndarray, "G"],
    correct: Bool[np.ndarray, "G"],
    *,
    matched: Bool[np.ndarray, "G"],
    identity: tuple[int, int, int],
    recovery: RecoveryCounts,
    uncertainty: tuple[Any, ...],
) -> PaperCounts:
    objects, index = number_ids(sightings.gt_id)
    share = np.bincount(index, correct, len(objects)) / np.maximum(1, np.bincount(index))
    is_mt, is_ml = share >= _MOSTLY_TRACKED, share <= _MOSTLY_LOST
    counts = (
        len(answer),
        matched.sum(),
        correct.sum(),
        *identity,
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
    overlap = _of_detection(sightings, sightings.iou, 0.0)
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
    firm_id = np.where(sightings.is_firm, sightings.object_id, NO_ID)
    label = _of_detection(sightings, firm_id, NO_ID)
    return _answers(sightings, label, _object_class(sightings))


def _carries_reference(answers: Answers, answer: Int[np.ndarray, "G"]) -> Bool[np.ndarray, "G"]:
    """Whether each observation is answered by its object's reference.

    `answer` is `answers.label`, or the same without some answers; other values count as answered.
    """
    reference = find_reference(answers)
    if not len(reference):
        return np.zeros(len(answer), bool)
    expected = reference[np.searchsorted(answers.objects, answers.gt_id)]
    return (answer != NO_LABEL) & (answers.label == expected) & (answers.label != NO_LABEL)


def _count_returns(sightings: Sightings) -> RecoveryCounts:
    answers = _firm_answers(sightings)
    return count_recovery(answers, find_reference(answers))


def _unshared_answers(
    sightings: Sightings, collapsed: Int[np.ndarray, "N"]
) -> Int[np.ndarray, "G"]:
    """The collapsed id of each observation, NO_ID where two objects carry it in that frame."""
    shown = np.flatnonzero((collapsed != NO_ID) & (sightings.row != NO_OBJECT))
    key = np.stack([sightings.frame[shown], collapsed[shown]])
    _, member, count = np.unique(key, axis=1, return_inverse=True, return_counts=True)
    alone = shown[count[member.ravel()] == 1]
    answer = np.full(len(sightings.gt_id), NO_ID, np.int64)
    answer[sightings.row[alone]] = collapsed[alone]
    return answer


def _object_class(sightings: Sightings) -> dict[int, int]:
    """Class of each stored object: that of its first firm detection."""
    firm = np.flatnonzero(sightings.is_firm)[::-1]
    ids, classes = sightings.object_id[firm].tolist(), sightings.class_id[firm].tolist()
    return dict(zip(ids, classes, strict=True))


def _label_class(sightings: Sightings, collapsed: Int[np.ndarray, "N"]) -> dict[int, int]:
    """Class of each collapsed id: of the stored object, or for a birth that of its truth."""
    classes = _object_class(sightings)
    born = np.flatnonzero((collapsed >= PROVISIONAL_BASE) & (sightings.row != NO_OBJECT))[::-1]
    of_truth = sightings.gt_class[sightings.row[born]].tolist()
    return classes | dict(zip(collapsed[born].tolist(), of_truth, strict=True))


def _owners(sightings: Sightings) -> dict[int, int]:
    firm_id = np.where(sightings.is_firm, sightings.object_id, NO_ID)
    label = _of_detection(sightings, firm_id, NO_ID)
    return find_owners(sightings.gt_frame, sightings.gt_id, label)


def _owned(
    label: Int[np.ndarray, "G"], owners: dict[int, int], gt_id: Int[np.ndarray, "G"]
) -> Bool[np.ndarray, "G"]:
    pairs = zip(label.tolist(), gt_id.tolist(), strict=True)
    return np.array([n in owners and owners[n] == g for n, g in pairs], bool)


def _is_first(sightings: Sightings) -> Bool[np.ndarray, "G"]:
    """Observations in the first frame in which their object is visible."""
    _, index = number_ids(sightings.gt_id)
    first = np.full(index.max(initial=-1) + 1, np.iinfo(np.int64).max)
    np.minimum.at(first, index, sightings.gt_frame)
    return sightings.gt_frame == first[index]


def _count_hits(
    sightings: Sightings,
    detections: Int[np.ndarray, "A"],
    is_ambiguous: Bool[np.ndarray, "G"],
    owners: dict[int, int],
) -> int:
    shown, truth = sightings.candidate_id[detections], sightings.gt_id[is_ambiguous]
    return sum(
        any(owners.get(number, NO_OBJECT) == g for number in row if number in owners)
        for row, g in zip(shown.tolist(), truth.tolist(), strict=True)
    )


def _of_detection(sightings: Sightings, values: np.ndarray, otherwise: Any) -> np.ndarray:
    """A value of the detection that shows each observation."""
    detection = sightings.detection
    seen = detection != NO_OBJECT
    result = np.full(len(detection), otherwise, np.asarray(values).dtype)
    result[seen] = values[detection[seen]]
    return result
