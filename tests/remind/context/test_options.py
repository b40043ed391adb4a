"""Choices within a class, against the rules in plain Python.

Rules: method.md#kernel-support, method.md#class-options.
"""

import functools

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.context.options import (
    largest_choice,
    list_options,
    write_menu,
)
from tests.statics import make_static

from .scenes import thresholds

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
