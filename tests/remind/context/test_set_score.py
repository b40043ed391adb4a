"""Scores of sets, against the formulas of method.md#set-score written out plainly."""

import functools
import math

import jax
import numpy as np
import pytest

from remind_jax.remind.context.member_sets import Cohesion, Trust
from remind_jax.remind.context.options import Menu, Options
from remind_jax.remind.context.set_score import (
    FrameScale,
    Tally,
    empty_tally,
    rate_coverage,
    rate_sizes,
    score_sets,
    tally_choices,
)
from remind_jax.remind.thresholds.context import Sets

from .scenes import thresholds

pytestmark = pytest.mark.usefixtures("x64")
ROUNDING = 1e-12  # float64, some tens of operations on numbers below 10
assert_close = functools.partial(np.testing.assert_allclose, rtol=0, atol=ROUNDING)
_coverage, _score = jax.jit(rate_coverage), jax.jit(score_sets)
_rate_sizes = jax.jit(rate_sizes, static_argnums=0)
LARGEST = 8  # set


def scale_frame(num_detections: int, num_classes: int, t: Sets) -> FrameScale:
    number = np.int32(num_detections)
    return FrameScale(number, np.int32(num_classes), _rate_sizes(LARGEST, number, t))


def test_score_of_the_page():
    """method.md#example-company, the set of objects 0, 1 and 3; rounded to six places."""
    maturity = 1 - math.exp(-1.5)
    tally = Tally(
        info=np.float64(0.804763),
        support_sum=np.float64(3 * 0.529412),
        support_weight=np.float64(3),
        stability_sum=np.float64(3 * 0.876256),
        exclusivity_sum=np.float64(3 * 0.974359),
        exclusive=np.bool_(True),
    )
    cohesion = Cohesion(np.float64(6.5 / 8.5), np.float64(1))
    trust = Trust(np.float64(maturity), np.float64(maturity**0.85))
    t = thresholds().sets
    score = _score(np.int32(3), cohesion, trust, tally, scale_frame(3, 3, t), t)
    np.testing.assert_allclose(score, 0.632158, atol=1e-6)
    assert _coverage(np.int32(3), np.int32(3), thresholds().sets) == 1


def test_choices_are_summed_up():
    """Choosing nothing adds to the weights but not to the sums; two classes, one set."""
    menu = Menu(
        pool_size=np.int32(3),
        num_detections=np.int32(2),
        allowed=np.ones((3, 2, 2), bool),
        info=np.array([1.0, 0.5, 0.75]),
    )
    options = Options(
        ranked=np.array([[2, 1, 0]], np.int32),
        support=np.array([[[0, 0], [0.5, 0.25], [0.75, 0.5]]], float),
        target=np.array([2.0]),
        stability=np.array([0.3]),
        exclusivity=np.array([[0, 0.5, 0.25]], float),
        exclusive=np.array([[False, True, False]]),
    )
    start = jax.tree.map(lambda leaf: leaf[None], empty_tally(np.dtype("float64")))
    first = tally_choices(start, options, menu)
    second = tally_choices(jax.tree.map(lambda leaf: leaf[:, 1, 1], first), options, menu)
    nothing = jax.tree.map(lambda leaf: float(leaf[0, 0, 0]), first)
    assert nothing == Tally(1.0, 0.0, 2.0, 0.0, 0.0, 0.0)
    one = jax.tree.map(lambda leaf: float(leaf[0, 1, 1]), first)
    assert_close(jax.tree.leaves(one), [0.5, 2 * 0.25, 2, 0.3, 0.5, 1])
    three = jax.tree.map(lambda leaf: float(leaf[0, 2, 0]), second)
    assert_close(jax.tree.leaves(three), [0.375, 2 * 0.25 + 2 * 0.75, 4, 0.6, 0.5 + 2 * 0.25, 1])
