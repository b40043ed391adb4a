"""Why REMIND plus took a detection for what it did: evidence in log odds, candidate by candidate.

Probabilities and confidences lie in [0, 1].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from remind_jax.explanation.explanation import Explanation, Section
from remind_jax.plus.evidence import Evidence
from remind_jax.plus.verdicts import Stage
from remind_jax.printing.words import change, number


@dataclasses.dataclass(frozen=True)
class PlusCandidate:
    """A known object that the tracklet could have been."""

    object_id: int
    name: str
    log_odds: float  # sum of the parts
    probability: float  # beside all other candidates and a new object
    parts: dict[str, float]  # by kind of `evidence.Evidence`
    held_by: int | None  # other detection of the frame that was taken for it


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlusExplanation(Explanation):
    """Why one detection became what it became."""

    FORMAT = "remind-jax explanation of plus"

    id_without_delay: int | None  # the answer that was not revised by later frames
    stage: Stage  # how far the tracklet was decided before
    tracklet_id: int | None  # names the tracklet, and its object if that is new
    age: int  # detections of the tracklet, with this one
    is_decided: bool
    answer_id: int | None  # best answer, firm or not
    probability: float  # of the answer, before calibration
    margin: float | None  # log odds to the next best answer; None where nothing was open
    new_log_odds: float | None  # of being no known object; None where nothing was open
    new_probability: float | None
    candidates: tuple[PlusCandidate, ...]  # the most probable first

    def sections(self) -> Iterator[Section]:
        """The candidates, and a new object beside them."""
        if not self.candidates:
            return
        kinds = Evidence.kinds()
        rows = [
            (
                f"{'*' if c.object_id == self.answer_id else ' '} {c.name}",
                *(change(c.parts[part]) if c.parts[part] else "-" for part in c.parts),
                change(c.log_odds),
                number(c.probability),
                "" if c.held_by is None else f"detection {c.held_by} got it",
            )
            for c in self.candidates
        ]
        assert self.new_log_odds is not None
        assert self.new_probability is not None
        is_new = self.answer_id == self.tracklet_id
        new = f"{'*' if is_new else ' '} {self.label} {self.tracklet_id}, new"
        blank = ["-"] * len(kinds)
        rows.append((new, *blank, change(self.new_log_odds), number(self.new_probability), ""))
        heads = ("candidate", *(kind.replace("_", " ") for kind in kinds), "sum", "probability", "")
        ends = (0, len(heads) - 1)
        yield Section("candidates, evidence in log odds", (), heads, tuple(rows), ends)
