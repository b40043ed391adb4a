"""What the decisions of a frame are made of, for whoever asks why (`remind_jax.explanation.plus`).

Letters: `N` detections, `C` candidates.
"""

from __future__ import annotations

import enum

from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_ID
from remind_jax.numerics.pytree import pytree
from remind_jax.plus.evidence import Evidence
from remind_jax.plus.state import Answers, blank
from remind_jax.plus.static import NUM_CANDIDATES


class Stage(enum.IntEnum):
    """How far a tracklet is decided when a frame begins."""

    NONE = 0  # no detection
    OPEN = 1  # not decided yet
    SETTLED = 2  # decided before


@pytree
class Verdicts(Answers):
    """The answers of a frame, and why."""

    stage: Int[Array, "N"]  # Stage
    age: Int[Array, "N"]  # detections of the tracklet so far, with this one
    is_decided: Bool[Array, "N"]
    probability: Float[Array, "N"]  # of the answer before calibration, [0, 1]
    margin: Float[Array, "N"]  # log odds to the next best answer; 0 where nothing is open
    new_odds: Float[Array, "N"]  # log odds of being no known object
    option_id: Int[Array, "N C"]  # objects that were weighed, -1 padding
    option_odds: Float[Array, "N C"]  # log odds in the end
    option_belief: Float[Array, "N C"]  # probability beside all others and a new object
    evidence: Evidence  # of each of these objects

    @property
    def answers(self) -> Answers:
        """What the memory keeps of them."""
        return Answers(self.tracklet_id, self.answer_id)


def no_verdicts(num: int) -> Verdicts:
    """Verdicts about no detection at all."""
    sizes = {"N": num, "C": NUM_CANDIDATES, "X": NUM_CANDIDATES}
    nobody = dict.fromkeys(("tracklet_id", "answer_id", "option_id"), NO_ID)
    return blank(Verdicts, sizes, evidence=blank(Evidence, sizes), **nobody)
