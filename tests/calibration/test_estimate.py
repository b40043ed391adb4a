"""Thresholds follow the features: where they lie, how far they spread, whatever the order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.calibration.estimate import (
    COSINES,
    MAX_COSINE,
    PART_MERGE,
    SCORE_DIFFERENCES,
    SCORES,
    WEIGHTS,
    Evidence,
    Line,
    estimate,
    estimate_part_merge,
)
from remind_jax.config import load_config
from remind_jax.config.dotted_keys import flatten_fields

START = dict(flatten_fields(load_config("remind").for_backbone("patch-statistics").thresholds))
seeds = st.integers(0, 2**16)


def draw(seed: int, same: int = 60, other: int = 90) -> tuple[Evidence, np.ndarray]:
    rng = np.random.default_rng(seed)
    is_same = np.arange(same + other) < same
    value = np.clip(rng.normal(np.where(is_same, 0.85, 0.55)[:, None], 0.1, (150, 3)), 0, 1)
    present = rng.random((150, 3)) < 0.9
    return Evidence(value * present, present), is_same


def moved(evidence: Evidence, scale: float, offset: float) -> Evidence:
    return Evidence((scale * evidence.value + offset) * evidence.present, evidence.present)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_the_reference_features_keep_their_thresholds(seed):
    evidence, same = draw(seed)
    found = estimate(evidence, evidence, same, START)
    assert found == pytest.approx({name: START[name] for name in found})


@settings(deadline=None, max_examples=25)
@given(seeds, st.floats(0.2, 0.95), st.floats(0.0, 1.0))
def test_thresholds_move_with_cosines_and_differences_with_their_spread(seed, scale, place):
    offset = place * (1 - scale)
    evidence, same = draw(seed)
    found = estimate(evidence, moved(evidence, scale, offset), same, START)
    for name in SCORES:
        assert found[name] == pytest.approx(scale * START[name] + offset, abs=1e-6), name
    for name in SCORE_DIFFERENCES:
        assert found[name] == pytest.approx(scale * START[name], abs=1e-6), name
    for bank in ("appearance", "background", "parts"):
        wanted = scale * START[f"{bank}.duplicate"] + offset
        assert found[f"{bank}.duplicate"] == pytest.approx(wanted, abs=1e-6)
    assert [found[name] for name in WEIGHTS] == pytest.approx([START[name] for name in WEIGHTS])


@settings(deadline=None, max_examples=25)
@given(seeds, seeds)
def test_the_order_of_comparisons_does_not_matter(seed, shuffle):
    evidence, same = draw(seed)
    other = Evidence(draw(seed + 1)[0].value * evidence.present, evidence.present)
    order = np.random.default_rng(shuffle).permutation(len(same))
    pick = lambda one: Evidence(one.value[order], one.present[order])  # noqa: E731
    found = estimate(pick(evidence), pick(other), same[order], START)
    assert found == pytest.approx(estimate(evidence, other, same, START))


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_the_order_of_thresholds_stays(seed):
    evidence, same = draw(seed)
    rng = np.random.default_rng(seed)
    other = Evidence(rng.random((150, 3)) * evidence.present, evidence.present)
    found = estimate(evidence, other, same, START)
    for names in (SCORES, [f"appearance.{one}" for one in COSINES]):
        before = sorted(names, key=START.__getitem__)
        after = [found[name] for name in before]
        assert after == sorted(after)
    assert all(0 <= value <= 1 for value in found.values())


def test_a_term_that_spreads_less_weighs_more():
    evidence, same = draw(0)
    narrow = np.array([1.0, 0.1, 1.0])
    other = Evidence((evidence.value * narrow + 0.9 * (narrow < 1)) * evidence.present,
                     evidence.present)  # fmt: skip
    found = estimate(evidence, other, same, START)
    before, after = (np.array([of[name] for name in WEIGHTS]) for of in (START, found))
    assert after.sum() == pytest.approx(before.sum())
    assert after[1] / after[0] == pytest.approx(10 * before[1] / before[0])


def test_parts_are_merged_by_how_parts_lie():
    rng = np.random.default_rng(0)
    cosines = rng.random(200)
    found = estimate_part_merge(cosines, 0.5 * cosines[::-1] + 0.25, START)
    assert found == pytest.approx(0.5 * START[PART_MERGE] + 0.25)
    assert estimate_part_merge(cosines, np.zeros(0), START) == START[PART_MERGE]


def test_no_threshold_is_beyond_what_views_reach():
    assert Line(scale=3.0, offset=0.0).point(0.9) == MAX_COSINE < 1.0
