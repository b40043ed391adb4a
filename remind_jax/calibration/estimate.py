"""Thresholds for other features, from the same comparisons with both (calibration.md#the-map).

Letters: `S` comparisons, `T` terms of the visual score: object, background, parts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float

from remind_jax.numerics.pytree import T, pytree

TERMS = ("object", "background", "parts")
WEIGHTS = tuple(f"similarity.{term}_weight" for term in TERMS)
PART_MERGE = "perception.part_merge"
_BANKS = ("appearance", "background", "parts")


def _dotted(**sections: str) -> tuple[str, ...]:
    """Keys by section, with spaces between."""
    return tuple(f"{section}.{key}" for section, keys in sections.items() for key in keys.split())


# Numbers that visual or final scores are compared with.
SCORES = _dotted(
    matching="match min_visual lock_score dummy_cap",
    diagnosis="anchor_score strong_score ambiguous_score",
    influence="rescue_visual",
    competition="min_score confirmed_min_score",
    ambiguous="min_top min_candidate visual_min_top",
    provisional="min_top min_candidate visual_min_score",
    pending="ambiguous_min_visual ambiguous_min_total provisional_min_visual provisional_min_total",
    known_sets="soft_min_score",
)
# Numbers that differences of scores are compared with, or that are added to scores.
SCORE_DIFFERENCES = _dotted(
    matching="lock_gap",
    diagnosis="anchor_margin close strong_gap temperature temperature_least "
    "gap_center gap_scale gap_scale_least",
    influence="positive_cap negative_cap",
    stability="assignment_gap alternative_margin keep_margin",
    competition="max_gap confirmed_max_gap",
    ambiguous="gap clear_margin visual_gap",
    provisional="gap visual_margin visual_min_gap",
    pending="ambiguous_overlap_weight ambiguous_scores_weight ambiguous_place_weight "
    "provisional_overlap_weight provisional_scores_weight provisional_place_weight",
)
# Shares of a score, and the score at which they act.
SCORE_SHARES = {
    "matching.lock_relative_gap": "matching.lock_score",
    "ambiguous.relative_gap": "matching.match",
    "provisional.relative_gap": "matching.match",
}
# Cosines with prototypes of a bank, and differences of them, below `appearance` and so on.
COSINES = ("duplicate", "stable_duplicate", "merge", "stable_merge", "novel")
COSINE_DIFFERENCES = ("update_margin", "stable_margin")

_QUANTILES = np.linspace(0.05, 0.95, 19)
MAX_COSINE = 0.999  # of a threshold; what nothing reaches would keep views from being promoted
_MIN_SPREAD = 1e-6  # of cosines that say anything
_SHARE_LEAST = 1e-3  # of a score that a share is taken of


@dataclasses.dataclass(frozen=True)
class Line:
    """Where a cosine of the reference features lies among those of other features."""

    scale: float
    offset: float

    def point(self, value: float) -> float:
        """The number that takes the place of a threshold."""
        return min(max(self.scale * value + self.offset, 0.0), MAX_COSINE)

    def difference(self, value: float) -> float:
        """The number that takes the place of a difference of cosines."""
        return min(self.scale * value, 1.0)


@pytree
class Evidence:
    """Terms of the visual score with some features; an absent one has value 0."""

    value: Float[np.ndarray, "S T"]
    present: Bool[np.ndarray, "S T"]

    def score(self, weights: Float[np.ndarray, "T"]) -> Float[np.ndarray, "S"]:
        """Mean of the terms that are present, 0 where none is."""
        counted = weights * self.present
        return (self.value * counted).sum(axis=1) / np.maximum(counted.sum(axis=1), 1e-12)


def join(several: Sequence[T]) -> T:
    """The rows of several records of arrays, one after the other."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *several)


def estimate(
    reference: Evidence, features: Evidence, same: Bool[np.ndarray, "S"], start: Mapping[str, float]
) -> dict[str, float]:
    """Thresholds that do the same with features as with the reference (calibration.md#the-map)."""
    weights = np.array([start[name] for name in WEIGHTS])
    both = [reference.present[:, term] & features.present[:, term] for term in range(len(TERMS))]
    lines = [
        fit_line(*(balanced_quantiles(e.value[seen, k], same[seen]) for e in (reference, features)))
        for k, seen in enumerate(both)
    ]
    # A term that spreads half as much has twice the weight, so that it decides as much as before.
    moved = weights / np.array([max(line.scale, _MIN_SPREAD) for line in lines])
    moved *= weights.sum() / moved.sum()
    any_term = reference.present.any(axis=1) & features.present.any(axis=1)
    scores = [e.score(w)[any_term] for e, w in ((reference, weights), (features, moved))]
    line = fit_line(*(balanced_quantiles(score, same[any_term]) for score in scores))

    found = dict(zip(WEIGHTS, moved.tolist(), strict=True))
    found |= {name: line.point(start[name]) for name in SCORES}
    found |= {name: line.difference(start[name]) for name in SCORE_DIFFERENCES}
    for name, at in SCORE_SHARES.items():
        share = line.difference(start[name] * start[at]) / max(found[at], _SHARE_LEAST)
        found[name] = min(share, 1.0)
    for bank, of_term in zip(_BANKS, lines, strict=True):
        found |= {n: of_term.point(start[n]) for n in _below(bank, COSINES, start)}
        found |= {n: of_term.difference(start[n]) for n in _below(bank, COSINE_DIFFERENCES, start)}
    return found


def estimate_part_merge(
    reference: Float[np.ndarray, "P"], features: Float[np.ndarray, "Q"], start: Mapping[str, float]
) -> float:
    """From which cosine on two parts of an object are one (calibration.md#the-map)."""
    if not (len(reference) and len(features)):
        return start[PART_MERGE]
    quantiles = (np.quantile(cosines, _QUANTILES) for cosines in (reference, features))
    return fit_line(*quantiles).point(start[PART_MERGE])


def balanced_quantiles(
    values: Float[np.ndarray, "S"], same: Bool[np.ndarray, "S"]
) -> Float[np.ndarray, "Q"]:
    """Quantiles of a mixture of both kinds of comparisons, half and half; zeros for nothing."""
    if not len(values):
        return np.zeros_like(_QUANTILES)
    order = np.lexsort((same, values))  # equal values in one order, whatever it was
    values, same = values[order], same[order]
    num_same = max(int(same.sum()), 1)
    num_other = max(int((~same).sum()), 1)
    mass = np.where(same, 0.5 / num_same, 0.5 / num_other)
    middle = np.cumsum(mass) - mass / 2
    return np.interp(_QUANTILES * mass.sum(), middle, values)


def fit_line(reference: Float[np.ndarray, "Q"], features: Float[np.ndarray, "Q"]) -> Line:
    """The line through quantiles over quantiles, with equal say of both axes; it never falls.

    Quantiles that do not spread say nothing; then everything stays where it is.
    """
    spread = float(np.std(reference)), float(np.std(features))
    if min(spread) < _MIN_SPREAD:
        return Line(1.0, 0.0)
    scale = spread[1] / spread[0]
    return Line(scale, float(np.mean(features) - scale * np.mean(reference)))


def _below(bank: str, names: tuple[str, ...], start: Mapping[str, float]) -> list[str]:
    return [name for name in (f"{bank}.{one}" for one in names) if name in start]
