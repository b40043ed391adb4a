"""Answers that are given some frames late, and what turned out since (host).

A tracklet is decided after a few frames. Whoever can wait gets what is known by then.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from remind_jax.decision import Outcome, Reason, Status
from remind_jax.numerics.absent import NO_ID
from remind_jax.plus.forgetting import coming_ids
from remind_jax.plus.state import Answers
from remind_jax.tracks import Tracks


class _Latest(NamedTuple):
    """The latest answer for a tracklet."""

    object_id: int = NO_ID  # while it is undecided
    confidence: float = 0.0


def find_merges(state: Any) -> list[tuple[int, int]]:
    """What would have been an object of its own and is a known one, and which."""
    answers: Answers = state.answers
    own, kept = np.asarray(answers.tracklet_id), np.asarray(answers.answer_id)
    is_known = (kept != own) & ~np.isin(own, coming_ids(state))
    return [(int(own[row]), int(kept[row])) for row in np.flatnonzero(is_known)]


def evidence(state: Any) -> dict[str, Any]:
    """What `DelayedAnswers.push` needs of the memory after a frame."""
    return {"tracklet_id": state.answers.tracklet_id}


class DelayedAnswers:
    """Holds back the answers of some frames and revises them by what is known then.

    No id is given twice in a frame: where a revision would do so, the earlier answer stays. An
    answer that stays has the confidence that it has by then. An object is new where it is answered
    for the first time.
    """

    def __init__(self, delay: int) -> None:
        """`delay`: frames that an answer waits."""
        self._delay = delay
        self._waiting: deque[tuple[Any, Tracks, Int[np.ndarray, "N"]]] = deque()
        self._latest: dict[int, _Latest] = {}  # by tracklet, of those that wait
        self._begun: set[int] = set()  # objects whose own tracklet was answered

    def push(
        self, frame: Any, tracks: Tracks, evidence: Mapping[str, Sequence[int]]
    ) -> list[tuple[Any, Tracks]]:
        """Takes the answers of a frame; gives those that waited long enough, with their frames."""
        tracklet = np.array(evidence["tracklet_id"][: len(tracks)], int)
        answers = map(_Latest, tracks.object_id.tolist(), tracks.confidence.tolist())
        told = zip(tracklet.tolist(), answers, strict=True)
        self._latest |= {one: answer for one, answer in told if one != NO_ID}
        self._waiting.append((frame, tracks, tracklet))
        return [self._release() for _ in range(len(self._waiting) - self._delay)]

    def flush(self) -> list[tuple[Any, Tracks]]:
        """What still waits at the end."""
        return [self._release() for _ in range(len(self._waiting))]

    def _release(self) -> tuple[Any, Tracks]:
        frame, tracks, tracklet = self._waiting.popleft()
        latest = [self._latest.get(one, _Latest()) for one in tracklet.tolist()]
        still = {one for *_, waiting in self._waiting for one in waiting.tolist()}
        self._latest = {one: answer for one, answer in self._latest.items() if one in still}
        object_id, outcome = tracks.object_id.copy(), tracks.outcome.copy()
        reason, confidence = tracks.reason.copy(), tracks.confidence.copy()
        status = tracks.status.copy()
        score = tracks.score.copy()  # the confidence, as everywhere in plus
        taken = {int(now) for now in object_id if now != NO_ID}
        # One that waits for an id that another gives up comes after that one.
        for row, (now, sure) in 2 * [*enumerate(latest)]:
            if now == NO_ID or (now in taken and now != object_id[row]):
                continue
            if now != object_id[row]:
                taken = {*taken, now} - {int(object_id[row])}
                object_id[row], status[row] = now, Status.STRONG
                outcome[row], reason[row] = Outcome.MATCH, Reason.ASSIGNED
            confidence[row] = score[row] = sure
        settled = object_id != NO_ID
        is_own = settled & (object_id == tracklet)
        # One that was shown before, in a run that this one goes on from, matches from the start.
        may_begin = (outcome == Outcome.NEW) | (object_id != tracks.object_id)
        has_begun = np.array([one in self._begun for one in object_id.tolist()], bool)
        begins = is_own & may_begin & ~has_begun
        self._begun.update(object_id[is_own].tolist())
        for rows, said in (
            (is_own & (outcome == Outcome.NEW), (Outcome.MATCH, Reason.ASSIGNED)),
            (begins, (Outcome.NEW, Reason.CREATED_NEW)),
        ):
            outcome[rows], reason[rows] = said
        changed = dataclasses.replace(
            tracks,
            object_id=object_id,
            outcome=outcome,
            reason=reason,
            status=status,
            score=score,
            confidence=confidence,
            pending_id=np.where(settled, NO_ID, tracks.pending_id),
            candidate_id=np.where(settled[:, None], NO_ID, tracks.candidate_id),
            candidate_score=np.where(settled[:, None], 0.0, tracks.candidate_score),
        )
        return frame, changed
