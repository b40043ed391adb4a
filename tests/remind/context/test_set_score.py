"""Scores of sets, against the formulas of method.md#set-score written out plainly."""

import dataclasses
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


def clip(value: float) -> float:
    return min(1.0, max(0.0, value))


def coverage_plainly(size: int, number: int, t: Sets) -> float:
    share = clip(size / max(1, number)) ** t.coverage_power
    if number > 1:
        share *= 1 + t.coverage_gain * (1 - math.exp(-(number - 1) / t.coverage_gain_scale))
    if t.explained_scale > 1e-12:
        share *= 1 - math.exp(-size / t.explained_scale)
    return clip(share)


def decline(reference: float, power: float, low: float, high: float, size: int) -> float:
    return min(high, max(low, (reference / max(1, size)) ** power))


def score_plainly(size, cohesion, trust, tally, scale, t: Sets) -> float:
    terms = [
        (t.coverage_weight, coverage_plainly(size, scale.num_detections, t)),
        (t.size_weight, clip(1 - math.exp(-max(0, size - t.size_free) / t.size_scale))),
        (
            t.info_weight
            * decline(t.info_reference, t.info_power, t.info_weight_min, t.info_weight_max, size),
            tally.info,
        ),
    ]
    if size >= 2:
        terms.append((t.density_weight, cohesion.density))
    terms.append((t.support_weight, tally.support_sum / max(tally.support_weight, 1)))
    terms.append((t.stability_weight, tally.stability_sum / scale.num_classes))
    mature = trust.maturity >= t.exclusivity_min_maturity
    if tally.exclusive and t.exclusivity and size >= t.exclusivity_min_size and mature:
        weight = t.exclusivity_weight * decline(
            t.exclusivity_reference, t.exclusivity_power,
            t.exclusivity_weight_min, t.exclusivity_weight_max, size,
        )  # fmt: skip
        terms.append((weight, tally.exclusivity_sum / max(1, size)))
    total = sum(weight for weight, _ in terms)
    if total <= 1e-12:
        return 0.0
    mean = sum(weight * clip(value) for weight, value in terms) / total
    return clip(clip(mean) * cohesion.connection * trust.reliability)


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"exclusivity": False, "coverage_power": 2.0, "explained_scale": 0.0},
        {"info_power": 2.0, "exclusivity_power": 0.0, "size_free": 0, "coverage_gain": 0.0},
        {"info_weight_max": 0.5, "exclusivity_min_size": 1, "exclusivity_weight_min": 0.9},
        {"density_weight": 0.0, "support_weight": 0.0, "exclusivity_min_maturity": 0.0},
        {f"{name}_weight": 0.0 for name in (
            "coverage", "size", "density", "info", "support", "stability", "exclusivity"
        )},
    ],
)  # fmt: skip
def test_scores_are_weighted_means(changed):
    generator, num = np.random.default_rng(0), 200
    size = generator.integers(0, LARGEST + 1, num).astype(np.int32)
    share = lambda: generator.random(num)  # noqa: E731
    cohesion = Cohesion(density=share(), connection=generator.choice([0.0, 0.5, 1.0], num))
    trust = Trust(generator.choice([0.1, 0.35, 0.9], num), share())
    weight = generator.integers(1, 6, num).astype(float)
    tally = Tally(share(), share() * weight, weight, 2 * share(), share() * size, share() < 0.5)
    t = thresholds(sets=changed).sets
    scale = scale_frame(7, 2, t)
    found = _score(size, cohesion, trust, tally, scale, t)
    rules = dataclasses.replace(Sets(), **changed)
    for row in range(num):
        pick = functools.partial(jax.tree.map, lambda leaf, row=row: leaf[row].item())
        plain = score_plainly(
            int(size[row]), pick(cohesion), pick(trust), pick(tally), scale, rules
        )
        assert_close(found[row], plain)


@pytest.mark.parametrize("number", [1, 2, 5, 12])
@pytest.mark.parametrize("changed", [{}, {"coverage_power": 0.5, "explained_scale": 0.0}])
def test_coverage(number, changed):
    sizes = np.arange(number + 1)
    found = _coverage(sizes, np.int32(number), thresholds(sets=changed).sets)
    rules = dataclasses.replace(Sets(), **changed)
    assert_close(found, [coverage_plainly(int(size), number, rules) for size in sizes])
    assert found[0] == 0


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
