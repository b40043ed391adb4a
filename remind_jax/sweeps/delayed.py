"""Answers of a sweep wait as those of a run do, to be revised by what turns out meanwhile (host).

Letters: `S` settings, `T` frames, `N` detection slots.
"""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
from jaxtyping import Float, Int

from remind_jax.decision import NO_ID
from remind_jax.method import Method
from remind_jax.sweeps.program import Answers


@dataclasses.dataclass(frozen=True)
class Said:
    """What is answered in a frame: the fields of `tracks.Tracks` that a revision may change."""

    outcome: Int[np.ndarray, "N"]
    reason: Int[np.ndarray, "N"]
    object_id: Int[np.ndarray, "N"]
    pending_id: Int[np.ndarray, "N"]
    status: Int[np.ndarray, "N"]
    score: Float[np.ndarray, "N"]
    confidence: Float[np.ndarray, "N"]
    candidate_id: Int[np.ndarray, "N 0"]
    candidate_score: Float[np.ndarray, "N 0"]

    def __len__(self) -> int:
        return len(self.object_id)


def revise(answers: Answers, method: Method, delay: int) -> Answers:
    """The answers as they are when each waited so many frames, or until the end."""
    if not delay or method.host.delayed is None:
        return answers
    revised = jax.tree.map(np.array, answers)
    num_frames, num_settings, slots = answers.outcome.shape
    unknown, none = np.zeros(slots, np.int32), np.zeros((slots, 0), np.int32)
    for s in range(num_settings):
        delayed, done = method.host.delayed(delay), []
        for t in range(num_frames):
            ids, score = np.asarray(answers.object_id[t, s]), np.asarray(answers.score[t, s])
            said = Said(
                outcome=np.asarray(answers.outcome[t, s]),
                reason=unknown,
                object_id=ids,
                pending_id=np.full_like(ids, NO_ID),
                status=unknown,
                score=score,
                confidence=score,
                candidate_id=none,
                candidate_score=none.astype(score.dtype),
            )
            evidence = {name: leaf[t, s] for name, leaf in answers.evidence.items()}
            done += delayed.push(t, said, evidence)
        for t, said in [*done, *delayed.flush()]:
            revised.outcome[t, s], revised.object_id[t, s] = said.outcome, said.object_id
            revised.score[t, s] = said.score
    return revised
