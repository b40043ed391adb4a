"""Counts, scores and named deviations of the paper's protocol; `paper` does the counting."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from remind_jax.metrics.combine import ratio

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
class PaperCounts:
    """What the paper's scores are made of; counts of several scenes add up."""

    observations: Float[np.ndarray, "*batch"]
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
    firm: Float[np.ndarray, "*batch"]
    firm_right: Float[np.ndarray, "*batch"]
    ambiguous: Float[np.ndarray, "*batch"]
    candidate_hits: Float[np.ndarray, "*batch"]
    ambiguous_right: Float[np.ndarray, "*batch"]


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
        "FirmShare": ratio(counts.firm, counts.observations),
        "FirmAccuracy": ratio(counts.firm_right, counts.firm),
        "AmbiguousShare": ratio(counts.ambiguous, counts.observations),
        "CandidateHitRate": ratio(counts.candidate_hits, counts.ambiguous),
        "CollapseAccuracy": ratio(counts.ambiguous_right, counts.ambiguous),
        "WeakShare": ratio(
            counts.observations - counts.firm - counts.ambiguous, counts.observations
        ),
    }
