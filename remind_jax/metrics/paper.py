"""The paper's protocol: the original evaluator's definitions (evaluation.md#paper-protocol).

Letters: `N` detections, `G` observations (a visible object in a frame).
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.collapse import PROVISIONAL_BASE, collapse_published
from remind_jax.metrics.combine import ratio
from remind_jax.metrics.decisions import NO_ROW, Decisions, take_or
from remind_jax.metrics.recovery import ANY_CLASS, NO_LABEL, Answers, count_recovery, find_reference
from remind_jax.metrics.uncertainty import (
    UncertaintyCounts,
    find_owners,
    holds_truth,
    is_owned,
    uncertainty_scores,
)

# Classes that the original leaves out of truth and predictions.
IGNORED_CLASSES = ("wall", "floor", "ceiling", "object")

_COMMON_LEGEND = (
    "A prediction matches an object of its class at any overlap above 0 (TrackEval: 0.5).",
    "DetA is the share of observations with a match; false positives do not count. HOTA is "
    "sqrt(DetA AssA) of these, without thresholds.",
    "The reference of an object is found per class, common frames first, then overlap.",
    "Recovery uses that reference over firm ids; an undecided answer recovers nothing.",
    "Objects and predictions of the classes wall, floor, ceiling and object are left out.",
    "Masks are compared at the size of the truth (original: width 1280 at most, cropped to "
    "multiples of 16).",
)
REMIND_LEGEND = (
    "Paper protocol, formulas for REMIND: every detection is collapsed to one id first.",
    "The frame of a birth never has the id of the object that was born: each birth costs a false "
    "and a missed observation and a switch.",
    "AssA is the share of matches that are right: a first observation if it is new, a later one "
    "if the majority of its id's firm observations is of this object; one owner may have many ids.",
    "IDFP counts ids per frame, unmatched detections included.",
    "An id that two objects carry in one frame counts for neither.",
    "Deviation from the original: the collapse never leaves the candidate set.",
    *_COMMON_LEGEND,
)
GENERIC_LEGEND = (
    "Paper protocol, generic formulas (MASA, DAM4SAM): one id per detection, no birth penalty.",
    "False positives are free: IDFP counts only predictions that match an object.",
    "AssA is IDTP over matches, so IDR = DetA AssA.",
    *_COMMON_LEGEND,
)


@dataclasses.dataclass(frozen=True)
class PaperCounts(UncertaintyCounts):
    """What the paper's scores are made of; counts of several scenes add up."""

    ambiguous_right: Float[np.ndarray, "*batch"]
    matched: Float[np.ndarray, "*batch"]
    right: Float[np.ndarray, "*batch"]  # correct by the rule of the path
    idtp: Float[np.ndarray, "*batch"]
    idfp: Float[np.ndarray, "*batch"]
    idfn: Float[np.ndarray, "*batch"]
    switches: Float[np.ndarray, "*batch"]
    fragments: Float[np.ndarray, "*batch"]
    mostly_tracked: Float[np.ndarray, "*batch"]
    partly_tracked: Float[np.ndarray, "*batch"]
    mostly_lost: Float[np.ndarray, "*batch"]
    opportunities: Float[np.ndarray, "*batch"]
    recovered: Float[np.ndarray, "*batch"]
    hard_recovered: Float[np.ndarray, "*batch"]


def paper_scores(counts: PaperCounts) -> dict[str, Any]:
    """The paper's scores under the names of the standard ones; NaN where undefined."""
    idtp, idfp, idfn = counts.idtp, counts.idfp, counts.idfn
    det_a = ratio(counts.matched, counts.observations)
    ass_a = ratio(counts.right, counts.matched)
    return {
        "IDF1": ratio(2 * idtp, 2 * idtp + idfp + idfn),
        "IDP": ratio(idtp, idtp + idfp),
        "IDR": ratio(idtp, idtp + idfn),
        "DetA": det_a,
        "AssA": ass_a,
        "HOTA": np.sqrt(det_a * ass_a),
        "Recovery": ratio(counts.recovered, counts.opportunities),
        "HardRecovery": ratio(counts.hard_recovered, counts.opportunities),
        "IDSWRate": ratio(counts.switches, counts.observations),
        "IDTP": idtp,
        "IDFP": idfp,
        "IDFN": idfn,
        "IDSW": counts.switches,
        "Frag": counts.fragments,
        "MT": counts.mostly_tracked,
        "PT": counts.partly_tracked,
        "ML": counts.mostly_lost,
        "GT_Dets": counts.observations,
        "Opportunities": counts.opportunities,
        **uncertainty_scores(counts),
        "CollapseAccuracy": ratio(counts.ambiguous_right, counts.ambiguous),
    }


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
    objects, index = np.unique(sightings.gt_id, return_inverse=True)
    share = np.bincount(index, correct, len(objects)) / np.maximum(1, np.bincount(index))
    is_mt, is_ml = share >= _MOSTLY_TRACKED, share <= _MOSTLY_LOST
    firm = _firm_answers(sightings)
    recovery = count_recovery(firm, find_reference(firm))
    counts = (
        len(answer),
        *uncertainty,
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
    names, number = np.unique(label[said], return_inverse=True)
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
    _, first, index = np.unique(sightings.gt_id, return_index=True, return_inverse=True)
    return sightings.gt_frame == sightings.gt_frame[first[index]]
