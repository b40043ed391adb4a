"""What follows from hypotheses, against an independent plain implementation.

Rules: method.md#hypothesis-summary, method.md#class-summary.
"""

import functools

import jax
import numpy as np
import pytest

from remind_jax.remind.context.hypotheses import Hypotheses, no_hypotheses
from remind_jax.remind.context.summary import summarize

from .scenes import (
    NUM,
    SLOTS,
    STATIC,
    example,
    read_view,
    thresholds,
)

pytestmark = pytest.mark.usefixtures("x64")
ROUNDING = 1e-12  # float64 sums of at most 20 numbers below 1
assert_close = functools.partial(np.testing.assert_allclose, rtol=0, atol=ROUNDING)


@functools.partial(jax.jit, static_argnames="static")
def _summarize(hypotheses, scene, t, static):
    return summarize(hypotheses, read_view(scene, t, static), static, t.sets, t.influence)


def summarize_on(hypotheses, scene, **changed):
    return jax.device_get(_summarize(hypotheses, scene, thresholds(**changed), static=STATIC))


def hypotheses_of_the_page() -> Hypotheses:
    """method.md#example-company; scores as given there, to six places."""
    count = STATIC.switches.num_hypotheses
    sets = [{0, 1, 3}, {0, 3}, {0, 1}, {1, 3}, {0, 2, 3}, {0, 2}, {2, 3}]
    members = np.zeros((count, SLOTS), bool)
    for row, objects in enumerate(sets):
        members[row, list(objects)] = True
    score, best = np.zeros(count), np.arange(count) == 0
    score[:4] = [0.632158, 0.423142, 0.408374, 0.408374]
    return Hypotheses(
        score=score,
        members=members,
        detections=np.zeros((count, NUM), bool),
        coverage=np.where(best, 1.0, 0.0),
        density=np.where(best, 0.764706, 0.0),
        size=members.sum(1).astype(np.int32),
        maturity=np.where(best, 0.776870, 0.0),
        valid=np.arange(count) < len(sets),
    )


def test_summary_of_the_page():
    """method.md#example-company, which round to six places."""
    near = functools.partial(np.testing.assert_allclose, rtol=0, atol=2e-6)
    found = summarize_on(hypotheses_of_the_page(), example())
    near(found.standing.kernel[:3], [0.416290, 0.764706, 0.058824])
    np.testing.assert_array_equal(found.standing.hits[:3], [4, 2, 2])
    near(found.standing.kernel_relative[1:3], [1, 0.146064])
    near(found.standing.hypothesis_relative[:3], [1, 1, 0])
    np.testing.assert_array_equal(np.flatnonzero(found.standing.shortlist), [0, 1, 3])
    near(found.classes.selectivity[1], 0.853936)
    near(found.classes.strength[:2], [0.470257, 0.731569])
    near(found.classes.pruning[:5], [0, 0.5, 0.5, 0, 0])
    near(found.quality, 0.642778)
    assert found.global_ok


@pytest.mark.parametrize(
    "changed",
    [{"min_best_score": 0.6322}, {"min_coverage": 1.01}, {"min_size": 4}, {"min_quality": 0.643}],
)
def test_poor_context_does_not_count(changed):
    found = summarize_on(hypotheses_of_the_page(), example(), influence=changed)
    assert not found.global_ok


def test_quality_of_one_term_alone():
    off = {
        f"{name}_weight": 0.0
        for name in ("best", "coverage", "maturity", "density", "size", "pruning")
    }
    terms = {
        "best": 0.632158, "coverage": 1.0, "maturity": 0.776870, "density": 0.764706,
        "size": 1 - np.exp(-2 / 3), "pruning": 0.125,
    }  # fmt: skip
    for name, value in terms.items():
        changed = {**off, f"{name}_weight": 0.3}
        found = summarize_on(hypotheses_of_the_page(), example(), influence=changed)
        assert_close(found.quality, value, err_msg=name)
    negative = {**off, "best_weight": -1.0}
    for weights in (off, negative):
        found = summarize_on(hypotheses_of_the_page(), example(), influence=weights)
        assert found.quality == 0


def test_no_hypotheses():
    found = summarize_on(no_hypotheses(NUM, SLOTS, STATIC), example())
    assert not found.global_ok
    assert not np.any(found.standing.shortlist)
    assert not np.any(found.standing.hypothesis_relative)
