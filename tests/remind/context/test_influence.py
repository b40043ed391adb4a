"""Support, contradiction and bonus, against method.md#cooccurrence-bonus in plain Python."""

import jax
import numpy as np
import pytest

from remind_jax.remind.context.influence import Influence, no_influence, weigh_influence
from remind_jax.remind.context.summary import ClassSummary, Context, Standing

from .scenes import thresholds

pytestmark = pytest.mark.usefixtures("x64")
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
