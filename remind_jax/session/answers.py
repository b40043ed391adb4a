"""The answers about a frame: the decisions of the step beside the outlines of the masks.

`outline` needs no decisions, so the host does it while the device computes them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.crops import Crops
from remind_jax.decision import NO_ID, Decisions, Outcome, Reason
from remind_jax.frame import Rle
from remind_jax.masks.run_length import encode_masks
from remind_jax.outputs.run_records import Event
from remind_jax.printing.words import plural
from remind_jax.session.announcement import rename_candidates
from remind_jax.session.preparation import Prepared
from remind_jax.tracks import Tracks


@dataclasses.dataclass(frozen=True)
class Outlines:
    """Masks as the result repeats them."""

    rles: tuple[Rle, ...]
    boxes: Float[np.ndarray, "N 4"]  # left, top, right, bottom, the last two excluded; pixels
    areas: Int[np.ndarray, "N"]  # pixels


def outline(masks: Bool[np.ndarray, "N H W"] | Crops) -> Outlines:
    """Encodes and measures pixel masks; the box of an empty one is zero."""
    crops = Crops.of(masks)
    boxes = np.array([crops.box(row) for row in range(len(crops))], np.float32).reshape(-1, 4)
    boxes[:, 2:] += boxes[:, :2]
    return Outlines(encode_masks(crops), boxes, crops.areas)


def read_tracks(prepared: Prepared, outlines: Outlines, decisions: Decisions) -> Tracks:
    """Joins what was decided and what was seen.

    Args:
      decisions: Host arrays; slots behind the detections are left out.
    """
    frame, detections, is_double = prepared.frame, prepared.detections, prepared.is_double
    num, d = len(detections), decisions
    is_blank = d.outcome[:num] == Outcome.EMPTY  # to the step an empty mask is no detection
    outcome = np.where(is_double | is_blank, Outcome.DROPPED, d.outcome[:num])
    reason = np.where(is_blank, Reason.INVALID_INPUT, d.reason[:num])
    candidate_id, candidate_score = _name_candidates(d)

    def take(values: Any) -> np.ndarray:
        return np.asarray(values)[:num]

    return Tracks(
        frame_index=frame.index,
        source_index=frame.source_index,
        time_s=frame.time_s,
        name=frame.name,
        frame_size=frame.size,
        outcome=outcome.astype(d.outcome.dtype),
        reason=np.where(is_double, Reason.DOUBLE, reason).astype(d.reason.dtype),
        object_id=take(d.object_id),
        pending_id=take(d.pending_id),
        status=take(d.status),
        score=take(d.score),
        confidence=take(d.confidence),
        candidate_id=take(candidate_id),
        candidate_score=take(candidate_score),
        labels=detections.labels,
        boxes=outlines.boxes,
        areas=outlines.areas,
        detector_scores=detections.scores,
        instance_ids=detections.instance_ids,
        rles=outlines.rles,
    )


def note_omissions(
    prepared: Prepared, decisions: Decisions, ignored_classes: Sequence[str]
) -> list[Event]:
    """What of a frame nothing was decided about."""
    index, num, omitted = prepared.frame.index, len(prepared.detections), []
    if prepared.num_ignored and not num:
        message = (
            f"all {prepared.num_ignored} detections are of ignored classes "
            f"({', '.join(ignored_classes)}); see input.ignored_classes"
        )
        omitted.append(Event(index, "ignored", message))
    if bad := int(decisions.num_bad_patches):
        message = f"{bad} patches were left out for a feature that is not finite or far too large"
        omitted.append(Event(index, "features", message))
    is_second = np.asarray(decisions.reason[:num]) == Reason.DOUBLE
    if doubles := int(np.sum(prepared.is_double | is_second)):
        message = (
            f"left out, as another shows the same thing: {plural(doubles, 'detection')}; "
            "see input.double_overlap and names.cropped"
        )
        omitted.append(Event(index, "double", message))
    used = np.asarray(prepared.masks.valid[:num]) | prepared.is_double
    if empty := num - int(np.sum(used)):
        omitted.append(Event(index, "dropped", f"dropped {plural(empty, 'empty mask')}"))
    return omitted


def _name_candidates(d: Decisions) -> tuple[np.ndarray, np.ndarray]:
    """Ids and scores `[N, C]`: what an undecided detection could be, else the visually nearest."""
    width = max(d.candidate_id.shape[1], d.option_id.shape[1])

    def widen(values: Any, blank: float) -> np.ndarray:
        lacking = width - values.shape[1]
        return np.pad(values, ((0, 0), (0, lacking)), constant_values=blank)

    undecided = np.asarray(d.option_id)[:, :1] != NO_ID
    named = np.where(undecided, widen(d.option_id, NO_ID), widen(d.candidate_id, NO_ID))
    scores = np.where(undecided, widen(d.option_score, 0.0), widen(d.candidate_score, 0.0))
    return named, scores


def as_merged(tracks: Tracks, merged_into: Mapping[int, int]) -> Tracks:
    """The answers with merged objects under one id.

    Where two of them are in one frame, the better match has the id, the other is undecided.
    """
    given = tracks.object_id
    object_id = np.array([merged_into.get(int(one), int(one)) for one in given], given.dtype)
    outcome, reason = tracks.outcome.copy(), tracks.reason.copy()
    candidate_id, candidate_score = rename_candidates(tracks, lambda one: merged_into.get(one, one))
    is_one = (np.sum(candidate_id != NO_ID, axis=1) == 1) & (outcome == Outcome.AMBIGUOUS)
    is_one &= np.sum(tracks.candidate_id != NO_ID, axis=1) > 1
    outcome[is_one], reason[is_one] = Outcome.PROVISIONAL_PARENT, Reason.UNCERTAIN_PARENT
    for shared in {int(one) for one in object_id if one != NO_ID}:
        rows = np.flatnonzero(object_id == shared)
        best = rows[np.argmax(tracks.score[rows])]
        lost = rows[given[rows] != given[best]]
        object_id[lost] = NO_ID
        outcome[lost], reason[lost] = Outcome.AMBIGUOUS, Reason.KNOWN_BUT_HELD_BY_BETTER_MATCH
        if candidate_id.shape[1]:
            candidate_id[lost, 0], candidate_id[lost, 1:] = shared, NO_ID
            candidate_score[lost, 0] = tracks.score[lost]
            candidate_score[lost, 1:] = 0.0
    return dataclasses.replace(
        tracks,
        object_id=object_id,
        outcome=outcome,
        reason=reason,
        candidate_id=candidate_id,
        candidate_score=candidate_score,
    )
