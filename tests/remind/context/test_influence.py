"""Support, contradiction and bonus, against method.md#cooccurrence-bonus in plain Python."""

import dataclasses
import functools
from typing import Any

import jax
import numpy as np
import pytest

from remind_jax.remind.context.influence import Influence, no_influence, weigh_influence
from remind_jax.remind.context.summary import ClassSummary, Context, Standing
from remind_jax.remind.thresholds.context import Influence as Rules

from .scenes import thresholds

pytestmark = pytest.mark.usefixtures("x64")
ROUNDING = 1e-12  # float64, some ten operations on numbers below 1
assert_close = functools.partial(np.testing.assert_allclose, rtol=0, atol=ROUNDING)
_weigh = jax.jit(weigh_influence)
OBJECTS = 400
SAID = ("bonus_raw", "score_sets", "support", "contradiction", "compat_rel", "kernel_raw")


def weigh(context: Context, exists: np.ndarray, **changed) -> Influence:
    return jax.device_get(_weigh(context, exists, thresholds(influence=changed).influence))


def draw_context(quality: float, global_ok: bool = True) -> Context:
    """Objects with values at, just below and above the thresholds as well as far from them."""
    generator = np.random.default_rng(0)

    def draw(*values):
        return generator.choice(values, OBJECTS)

    standing = Standing(
        kernel=draw(0.0, 0.05, np.nextafter(0.1, 0), 0.1, 0.3, 0.9),
        hits=draw(0, 1, 2, 3).astype(np.int32),
        hit_share=draw(0.0, np.nextafter(0.25, 0), 0.25, 0.5, 1.0),
        covered=draw(True, True, False),
        kernel_relative=draw(0.0, 0.1, np.nextafter(0.1, 1), 0.2, 0.6, 0.65, 1.0),
        hypothesis_relative=draw(0.0, 0.2, 0.7, 1.0),
        supported=draw(True, False),
        soft_supported=draw(True, False, False),
        shortlist=draw(True, False),
    )
    classes = ClassSummary(
        kept_count=draw(0, 1, 2, 4).astype(np.int32),
        pruning=draw(0.0, np.nextafter(0.35, 0), 0.35, 0.5, 0.9),
        strength=draw(0.1, np.nextafter(0.35, 0), 0.35, 0.8),
        selectivity=draw(0.0, 0.4, 1.0),
        best_kernel=draw(0.0, 0.05, 0.3, 0.9),
        best_relative=draw(0.0, 0.6, 1.0),
        # The cut may lie above a relative support by less than the slack of 1e-9.
        soft_cut=draw(0.0, 0.3, 0.6 + 5e-10, 0.65),
    )
    return Context(standing, classes, np.float64(quality), np.bool_(global_ok))


def clip(value: float) -> float:
    return min(1.0, max(0.0, value))


def weigh_plainly(s: Any, c: Any, quality: float, t: Rules) -> tuple[float, ...]:
    """Support, contradiction, bonus and whether the object is inside, of one object."""
    ready = s.kernel >= t.min_kernel and s.covered
    above_cut = s.kernel_relative >= max(0.0, c.soft_cut - 1e-9)
    inside = ready and (
        (c.best_relative > 0 and s.kernel_relative > 0 and above_cut) or s.soft_supported
    )
    local = 0.0
    enough = s.kernel >= t.local_min_kernel and s.hits >= t.local_min_hits
    if s.covered and enough and s.hit_share >= t.local_min_hit_share:
        least = t.local_min_hit_share
        local = clip(
            t.local_hits_weight * clip((s.hit_share - least) / (1 - least))
            + t.local_count_weight * clip(s.hits / max(1, t.local_min_hits))
            + t.local_kernel_weight * clip(s.kernel / max(1e-12, c.best_kernel, t.local_min_kernel))
        )
    overall = 0.0
    if inside and c.kept_count > 0:
        rank = clip((s.kernel_relative - t.neutral) / (1 - t.neutral))
        lead = clip((s.hypothesis_relative - t.neutral) / (1 - t.neutral))
        overall = clip(
            t.pruned_weight * c.pruning
            + t.rank_weight * rank
            + t.selectivity_weight * lead * (0.5 + 0.5 * c.selectivity)
        )
    weights = max(1e-12, t.local_weight + t.global_weight)
    support = clip((t.local_weight * local + t.global_weight * overall) / weights)
    decided = c.kept_count > 0 and c.pruning >= t.contradiction_min_pruning
    decided = decided and c.strength >= t.contradiction_min_strength
    against = decided and not inside and s.kernel_relative <= t.contradiction_max_support
    contradiction = c.pruning if against else 0.0
    bonus = t.positive_cap * quality * support - t.negative_cap * quality * contradiction
    return support, contradiction, bonus, inside


@pytest.mark.parametrize("quality", [0.35, 0.7])
@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"local_weight": 0.0, "positive_cap": 0.5, "neutral": 0.1},
        {"global_weight": 0.0, "local_min_hits": 3, "local_min_hit_share": 0.5},
        {"local_weight": 0.0, "global_weight": 0.0},
        {"min_kernel": 0.0, "contradiction_max_support": 0.2, "local_min_kernel": 0.3},
    ],
)
def test_objects_are_weighed_by_the_rules(quality, changed):
    context, exists = draw_context(quality), np.arange(OBJECTS) < OBJECTS - 20
    found = weigh(context, exists, **changed)
    rules = dataclasses.replace(Rules(), **changed)
    insiders = opponents = 0
    for one in np.flatnonzero(exists):
        pick = functools.partial(jax.tree.map, lambda leaf, one=one: leaf[one].item())
        plain = weigh_plainly(pick(context.standing), pick(context.classes), quality, rules)
        support, contradiction, bonus, inside = plain
        assert_close(found.support[one], support)
        assert_close(found.contradiction[one], contradiction)
        assert_close(found.score_sets[one], support - contradiction)
        assert_close(found.bonus_raw[one], bonus)
        assert found.compat_band[one] == inside
        insiders, opponents = insiders + inside, opponents + (contradiction > 0)
    assert min(insiders, opponents) >= 20
    for name in SAID:
        assert not np.any(getattr(found, name)[~exists]), name
    np.testing.assert_array_equal(found.has_pack, exists)


@pytest.mark.parametrize(("quality", "global_ok"), [(np.nextafter(0.35, 0), True), (0.9, False)])
def test_poor_context_neither_rewards_nor_punishes(quality, global_ok):
    """What protects from vetoes is said all the same (method.md#veto)."""
    context, exists = draw_context(quality, global_ok), np.ones(OBJECTS, bool)
    found = weigh(context, exists)
    for name in (*SAID, "compat_band"):
        assert not np.any(getattr(found, name)), name
    assert found.enabled
    np.testing.assert_array_equal(found.soft_supported, context.standing.soft_supported)
    np.testing.assert_array_equal(found.shortlist, context.standing.shortlist)
    np.testing.assert_array_equal(found.strength, context.classes.strength)


def test_bounds():
    """The largest change is a cap times the quality; insiders are not contradicted.

    Rule: method.md#cooccurrence-bonus.
    """
    found = weigh(draw_context(0.8), np.ones(OBJECTS, bool))
    assert not np.any((found.contradiction > 0) & found.compat_band)
    assert np.all((found.bonus_raw <= 0.2 * 0.8) & (found.bonus_raw >= -0.1 * 0.8))
    assert np.any(found.bonus_raw < 0)
    assert np.any(found.bonus_raw > 0.1)


def test_without_a_context_nothing_is_said():
    silent = jax.jit(no_influence, static_argnums=(0, 1))(4, np.dtype("float64"))
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(silent))
