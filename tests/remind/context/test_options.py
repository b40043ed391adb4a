"""Choices within a class, against the rules in plain Python.

Rules: method.md#kernel-support, method.md#class-options.
"""

import functools
import math

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.context.options import (
    largest_choice,
    list_options,
    support_by_kernel,
    write_menu,
)
from tests.statics import make_static

from .scenes import thresholds, view_of

pytestmark = pytest.mark.usefixtures("x64")
MOST, POOL = 3, 5  # most detections of a class; most objects of it
SMALL = make_static(precision="float64", class_pool=POOL, class_detections=MOST, option_objects=3)
ROUNDING = 1e-12  # float64, some tens of operations on numbers below 10
assert_close = functools.partial(np.testing.assert_allclose, rtol=0, atol=ROUNDING)
quick = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@functools.cache
def _rules():
    return thresholds().sets


@functools.partial(jax.jit, static_argnames=("most", "static"))
def _list(support, has_kernel, pool, pool_size, num_detections, t, most, static):
    menu = write_menu(pool_size, num_detections, most, static, t)
    return list_options(support, has_kernel, pool, menu, t), menu, largest_choice(menu)


def choices(support, has_kernel, pool, num_detections, most=MOST, static=SMALL):
    """Options of one set, its menu, and most objects that can be chosen; `pool` latest first."""
    place = np.arange(static.switches.class_pool + 1)
    listed = np.where(place < len(pool), np.resize(pool, len(place)), NO_SLOT).astype(np.int32)
    told = np.where(place < len(pool), np.resize(support, len(place)), 0.0)
    options, menu, largest = jax.device_get(
        _list(
            told[None], np.array([has_kernel]), listed, np.int32(len(pool)),
            np.int32(num_detections), _rules(), most=most, static=static,
        )
    )  # fmt: skip
    return jax.tree.map(lambda leaf: leaf[0], options), menu, largest


def list_plainly(support, has_kernel, pool, num_detections):
    """What the rules say of every choice, by count and object variant."""
    ranked = sorted(zip(support, pool, strict=True), reverse=True)
    value = [share for share, _ in ranked]
    plausible = 0
    while plausible < len(value) and value[plausible] + 1e-12 >= 0.75 * value[0]:
        plausible += 1
    target = min(num_detections, max(1, plausible))
    total, stability = sum(value), 0.0
    if has_kernel and total > 1e-12:
        shares = [share / total for share in value if share > 0]
        entropy = -sum(share * math.log(share) for share in shares)
        stability = 1 - min(1.0, entropy / math.log(max(2, len(shares))))
    rated, exclusivity = {}, {}
    for count in range(1, min(num_detections, len(pool)) + 1):
        chosen = [value[:count]]
        if min(len(pool), max(count, SMALL.switches.option_objects)) > count:
            chosen.append([*value[: count - 1], value[count]])
        terms = [sum(v) / count * min(1.0, count / target) for v in chosen]
        rated[count] = terms
        best = max(terms)
        second = max((one for one in terms if one < best - 1e-15), default=0.0)
        says = best > 1e-12 and (second > 0 or best - second > 1e-12)
        exclusivity[count] = ((best - second) / best if best > 1e-12 else 0.0, says)
    return [one for _, one in ranked], target, stability, rated, exclusivity


@quick
@given(
    st.lists(st.sampled_from([0.0, 0.0625, 0.3, 0.4, 1.0]), min_size=1, max_size=POOL),
    st.booleans(),
    st.integers(1, MOST),
)
def test_choices_are_rated_by_the_rules(support, has_kernel, num_detections):
    pool = list(range(len(support) + 3, 3, -1))
    options, menu, largest = choices(support, has_kernel, pool, num_detections)
    ranked, target, stability, rated, exclusivity = list_plainly(
        support, has_kernel, pool, num_detections
    )
    places = MOST + 1
    known = min(places, len(pool))
    assert options.ranked[:known].tolist() == ranked[:known]
    assert np.all(options.ranked[known:] == NO_SLOT)
    assert options.target == target
    assert largest == min(num_detections, len(pool))
    assert_close(options.stability, stability)
    assert not np.any(options.support[0])
    for count, terms in rated.items():
        assert_close(options.support[count, : len(terms)], terms)
        assert_close(options.exclusivity[count], exclusivity[count][0])
        assert options.exclusive[count] == exclusivity[count][1]
        ways = math.comb(len(pool), count)
        assert_close(menu.info[count], 1 / (1 + 0.35 * math.log(ways)))
    exist = {(0, 0, 0)}
    for count, terms in rated.items():
        for moved_det in range(1 + (num_detections > count)):
            exist |= {(count, moved_det, moved) for moved in range(len(terms))}
    assert {tuple(choice) for choice in np.argwhere(menu.allowed).tolist()} == exist


def test_choices_of_the_page():
    """method.md#example-company, class c1: objects 1 and 2, one detection."""
    support = np.array([0.5 / 8.5, 6.5 / 8.5])
    options, menu, largest = choices(support, True, [2, 1], 1)
    assert options.ranked[:2].tolist() == [1, 2]
    assert (options.target, largest) == (1, 1)
    np.testing.assert_allclose(options.support[1], support[::-1], atol=1e-15)
    # Rounded to six places there.
    np.testing.assert_allclose(options.stability, 0.628768, atol=1e-6)
    np.testing.assert_allclose(options.exclusivity[1], 0.923077, atol=1e-6)
    np.testing.assert_allclose(menu.info[1], 0.804763, atol=1e-6)
    assert options.exclusive[1]


def test_only_choice_leads_completely():
    options, menu, _ = choices([0.4], True, [3], 1)
    assert (options.exclusivity[1], options.exclusive[1]) == (1, True)
    assert menu.info[1] == 1
    nothing, *_ = choices([0.0], True, [3], 1)
    assert (nothing.exclusivity[1], nothing.exclusive[1]) == (0, False)


def test_equal_support_prefers_late_objects():
    options, *_ = choices([0.4, 0.4, 0.4, 0.5], True, [9, 7, 4, 2], 2)
    assert options.ranked.tolist() == [2, 9, 7, 4]


@functools.partial(jax.jit, static_argnames="static")
def _support(members, anchors, pool, conditional, maturity, t, static):
    view = view_of(conditional, anchors=anchors)
    return support_by_kernel(members, pool, view, maturity, static, t)


def support_plainly(members, anchors, one, conditional, maturity, kernel_size):
    """method.md#kernel-support: anchors, then members by rising id; silent ones do not count."""
    kernel = np.flatnonzero(anchors).tolist()
    kernel += [member for member in np.flatnonzero(members).tolist() if member not in kernel]
    kernel = kernel[:kernel_size]
    told = [conditional[other, one] for other in kernel if conditional[other, one] >= 0.05]
    if not kernel:
        return maturity[one], False
    return (sum(told) / len(told) if told else 0.0), True


def test_support_by_the_kernel():
    generator = np.random.default_rng(0)
    slots, sets, kernel_size = 7, 40, 3
    static = make_static(precision="float64", set_kernel=kernel_size)
    pool = np.array([6, 4, 1, NO_SLOT], np.int32)
    conditional = generator.choice([0.0, 0.04, 0.05, 0.3, 0.7], (slots, slots))
    maturity = generator.random(slots)
    members = generator.random((sets, slots)) < generator.random((sets, 1))
    members[0] = False
    for anchors in (np.zeros(slots, bool), np.isin(np.arange(slots), [1, 5])):
        found, has_kernel = jax.device_get(
            _support(members, anchors, pool, conditional, maturity, _rules(), static=static)
        )
        assert has_kernel[0] == np.any(anchors)
        for row in range(sets):
            for place, one in enumerate(pool[:3]):
                support, known = support_plainly(
                    members[row], anchors, one, conditional, maturity, kernel_size
                )
                assert has_kernel[row] == known
                assert_close(found[row, place], support)
