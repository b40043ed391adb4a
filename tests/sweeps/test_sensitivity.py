"""Sensitivities of formulas whose indices are known."""

import math

import numpy as np
import pytest

from remind_jax.config import load_config
from remind_jax.config.dotted_keys import flatten_fields
from remind_jax.errors import SweepError
from remind_jax.sweeps.search import GIVEN
from remind_jax.sweeps.sensitivity import (
    SPACES,
    curves_to_markdown,
    estimate_sobol,
    move_one_at_a_time,
    sobol_to_markdown,
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


def ishigami(setting, scene):
    """The test function of the literature, on [-pi, pi]^3."""
    x, y, z = (2 * math.pi * setting[name] - math.pi for name in ("x", "y", "z"))
    return {"IDF1": math.sin(x) + 7 * math.sin(y) ** 2 + 0.1 * z**4 * math.sin(x)}


def test_sobol_indices_are_those_of_the_literature():
    space = {name: (0.0, 1.0) for name in "xyz"}
    indices, result = estimate_sobol(FakeBench(ishigami, ("a",)), space, number=1024)
    found = {index.name: index for index in indices}
    # Analytic values; 1,024 points come within 0.05 of them.
    for name, first, total in (("x", 0.3139, 0.5576), ("y", 0.4424, 0.4424), ("z", 0.0, 0.2437)):
        assert found[name].first == pytest.approx(first, abs=0.05)
        assert found[name].total == pytest.approx(total, abs=0.05)
        assert found[name].total_interval[0] < total < found[name].total_interval[1]
    assert [index.name for index in indices] == ["x", "y", "z"]
    assert len(result.settings) == 1024 * (3 + 2)
    assert "| x | 0.3" in sobol_to_markdown(indices)


def test_whole_numbers_and_gates_take_all_their_values():
    seen = {"n": set(), "gate": set()}

    def look(setting, scene):
        for name, value in setting.items():
            seen[name].add(value)
        return {"IDF1": float(setting["n"])}

    indices, _ = estimate_sobol(
        FakeBench(look, ("a",)), {"n": (1, 3), "gate": (False, True)}, number=32
    )
    assert seen == {"n": {1, 2, 3}, "gate": {False, True}}
    assert [type(value) for value in seen["n"]] == [int] * 3
    assert {i.name: round(i.total, 6) for i in indices} == {
        "n": pytest.approx(1, abs=0.2),
        "gate": 0,
    }


def test_spread_keeps_kinds():
    assert spread((1, 4), 9) == [1, 2, 3, 4]
    assert spread((0.0, 1.0), 3) == [0.0, 0.5, 1.0]
    assert spread((False, True), 9) == [False, True]
    assert spread((0.1, 0.5, 0.7), 9) == [0.1, 0.5, 0.7]


def test_points_must_be_a_power_of_two():
    with pytest.raises(SweepError, match="power of two"):
        estimate_sobol(FakeBench(hill), number=100)
