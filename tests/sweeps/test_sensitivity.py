"""Sensitivities of formulas whose indices are known."""

import numpy as np
import pytest

from remind_jax.config import load_config
from remind_jax.config.dotted_keys import flatten_fields
from remind_jax.sweeps.search import GIVEN
from remind_jax.sweeps.sensitivity import (
    SPACES,
    Curve,
    curves_to_markdown,
    move_one_at_a_time,
    spread,
)
from remind_jax.sweeps.settings import complete
from tests.sweeps.fake_bench import FakeBench, hill


@pytest.mark.parametrize("tracker", SPACES)
def test_thresholds_varied_exist_and_their_ranges_hold_the_published_values(tracker):
    config = load_config("published").with_tracker(tracker)
    published = dict(flatten_fields(config.thresholds))
    for name, (low, high) in SPACES[tracker].items():
        assert low < published[name] < high, name
        assert type(published[name]) is type(low), name
    ends = [{name: ends[i] for name, ends in SPACES[tracker].items()} for i in (0, 1)]
    assert complete(ends, config) == ends  # raises if a value is not accepted


def test_curves_move_one_threshold_and_the_steepest_comes_first():
    space = {"matching.lock_score": (0.8, 0.9), "matching.match": (0.3, 0.9)}
    bench = FakeBench(hill)
    curves, result = move_one_at_a_time(bench, space, number=5)
    assert [curve.name for curve in curves] == ["matching.match", "matching.lock_score"]
    assert all(len(setting) <= 1 for setting in result.settings)
    assert curves[0].values == (0.3, 0.45, 0.6, 0.75, 0.9)
    expected = [
        np.mean([hill({"matching.match": v}, s)["IDF1"] for s in (0, 1)]) for v in curves[0].values
    ]
    np.testing.assert_allclose(curves[0].scores, expected)
    assert curves[0].given_score == pytest.approx(np.mean([hill(GIVEN, s)["IDF1"] for s in (0, 1)]))
    assert "| matching.match | 0.3 to 0.9 |" in curves_to_markdown(curves)


def test_what_is_only_as_good_is_not_called_best():
    flat = Curve("layout.weight", (0.0, 1.6), (0.9, 0.9), given_score=0.9)
    slope = Curve("decision.new", (0.0, 3.0), (0.8, 0.95), given_score=0.9)
    text = curves_to_markdown([slope, flat])
    assert "| decision.new | 0 to 3 | 0.150 | 3 | 0.950 | 0.900 |" in text
    assert "| layout.weight | 0 to 1.6 | 0.000 | as it stands | 0.900 | 0.900 |" in text


def test_spread_keeps_kinds():
    assert spread((1, 4), 9) == [1, 2, 3, 4]
    assert spread((0.0, 1.0), 3) == [0.0, 0.5, 1.0]
    assert spread((False, True), 9) == [False, True]
    assert spread((0.1, 0.5, 0.7), 9) == [0.1, 0.5, 0.7]
