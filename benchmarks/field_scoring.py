"""How well identities were kept over one absence, by the metrics of `remind_jax.metrics`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Int

from benchmarks.field_worlds import Trial
from remind_jax.metrics import TrackingSequence, evaluate_sequence, pool_evaluations
from remind_jax.metrics.evaluation import Evaluation
from remind_jax.metrics.recovery import Answers, collect_answers, count_recovery, find_reference

UNANSWERED = -1


@dataclasses.dataclass(frozen=True)
class Truth:
    """Who each detection of a trial is; rows ordered by frame."""

    num_frames: int
    frame: Int[np.ndarray, "M"]
    instance: Int[np.ndarray, "M"]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """One tracker on one trial."""

    evaluation: Evaluation
    returned: int  # objects seen before and after the absence
    recovered: int  # of them, called what they were called before, at least once
    recovered_at_once: int  # the same in their first frame
    taken_for_another: int  # called what another was called before, in their first frame
    unanswered: int  # detections without an identity


def truth_of(trial: Trial) -> Truth:
    """The true instances of all detections."""
    frames, instances = [], []
    for index, number in enumerate(trial.picture):
        if number >= 0:
            seen = np.unique(trial.pictures.instances[number])
            seen = seen[seen > 0]
            frames += [index] * len(seen)
            instances += seen.tolist()
    return Truth(len(trial.picture), np.array(frames, int), np.array(instances, int))


def first_sayings(frame: Int[np.ndarray, "M"], ids: Int[np.ndarray, "M"]) -> Int[np.ndarray, "K"]:
    """Rows with an identity that no earlier row of their frame has."""
    said = np.flatnonzero(ids != UNANSWERED)
    _, first = np.unique(np.stack([frame[said], ids[said]]), axis=1, return_index=True)
    return said[np.sort(first)]


def judge(trial: Trial, truth: Truth, ids: Int[np.ndarray, "M"]) -> Outcome:
    """Scores the identities of all detections; an id given twice in a frame counts once."""
    said = first_sayings(truth.frame, ids)
    sequence = TrackingSequence.create(
        truth.num_frames,
        (truth.frame, truth.instance),
        (truth.frame[said], ids[said]),
        (said, np.arange(len(said)), np.ones(len(said))),
        name=trial.name,
    )
    answers = collect_answers(sequence)
    returned, recovered, at_once, another = _across(answers, trial.gone, trial.back)
    return Outcome(
        evaluate_sequence(sequence), returned, recovered, at_once, another, len(ids) - len(said)
    )


def _across(answers: Answers, gone: int, back: int) -> tuple[int, int, int, int]:
    """Returns over the absence: all, recovered, in the first frame, taken for another.

    What counts as right is what the object was called before, one object per name: a new name that
    lasts longer than the old one recovers nothing.
    """
    is_before, is_after = answers.frame < gone, answers.frame >= back
    both = np.intersect1d(answers.gt_id[is_before], answers.gt_id[is_after])
    is_known = np.isin(answers.gt_id, both)
    before = _rows(answers, is_before & is_known)
    reference = find_reference(before)
    # One absence per object: gaps within the looks before and after it are closed.
    joined = _rows(answers, (is_before | is_after) & is_known)
    rank = np.zeros(len(joined.frame), int)
    for instance in both:
        own = np.flatnonzero(joined.gt_id == instance)
        own = own[np.argsort(joined.frame[own])]
        rank[own] = np.arange(len(own)) + (joined.frame[own] >= back)
    counts = count_recovery(dataclasses.replace(joined, frame=rank), reference)
    another = 0
    for place, instance in enumerate(both):
        own = np.flatnonzero((answers.gt_id == instance) & is_after)
        label = answers.label[own[np.argmin(answers.frame[own])]]
        another += label in np.delete(reference, place) and label != UNANSWERED
    recovered, at_once = counts.recovered.sum(), counts.hard_recovered.sum()
    return len(both), int(recovered), int(at_once), another


def _rows(answers: Answers, kept: np.ndarray) -> Answers:
    rows = ("frame", "gt_id", "label", "similarity", "gt_class")
    return dataclasses.replace(answers, **{name: getattr(answers, name)[kept] for name in rows})


def pool(outcomes: Iterable[Outcome]) -> dict[str, float]:
    """Scores over all trials of a question, in percent but for counts."""
    outcomes = list(outcomes)
    evaluation = pool_evaluations([one.evaluation for one in outcomes])
    scores = evaluation.scores()
    returned = sum(one.returned for one in outcomes)
    detections = scores["GT_Dets"]
    return {
        "idf1": 100 * scores["IDF1"],
        "recovery": 100 * sum(one.recovered for one in outcomes) / max(1, returned),
        "hard": 100 * sum(one.recovered_at_once for one in outcomes) / max(1, returned),
        "another": 100 * sum(one.taken_for_another for one in outcomes) / max(1, returned),
        "ids": scores["IDs"] / max(1.0, scores["GT_IDs"]),
        "unanswered": 100 * sum(one.unanswered for one in outcomes) / max(1.0, detections),
        "returned": float(returned),
    }
