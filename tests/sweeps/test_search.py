"""Searches find the top of a hill that is known, keep to their budget, and repeat themselves."""

import math
import sys

import pytest

from remind_jax.errors import SweepError
from remind_jax.sweeps.search import search
from tests.sweeps.fake_bench import FakeBench, hill

pytest.importorskip("optuna")

SPACE = {
    "matching.match": (0.3, 1.0),
    "matching.lock_score": (0.5, 1.0),
    "influence.enabled": (False, True),
}


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_search_beats_the_configuration_as_it_stands(sampler):
    bench = FakeBench(hill)
    result = search(bench, SPACE, number=48, at_once=8, sampler=sampler, seed=2)
    assert result.settings[0] == {}
    assert len(result.settings) == 49
    assert [len(settings) for settings in bench.asked] == [9, 8, 8, 8, 8, 8]
    best = result.best()[0]
    assert best.setting["influence.enabled"] is True
    assert best.scores["IDF1"] > result.standings()[0].scores["IDF1"] + 0.2


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_same_seed_same_settings(sampler):
    first, again = (
        search(FakeBench(hill), SPACE, number=24, at_once=6, sampler=sampler, seed=5)
        for _ in range(2)
    )
    other = search(FakeBench(hill), SPACE, number=24, at_once=6, sampler=sampler, seed=6)
    assert first.settings == again.settings
    assert first.settings != other.settings


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_two_objectives_give_a_front(sampler):
    result = search(
        FakeBench(hill), SPACE, number=64, at_once=16, sampler=sampler,
        objectives=("IDF1", "Firm"),
    )  # fmt: skip
    front = result.pareto()
    assert len(front) > 3
    scores = [(s.scores["IDF1"], 1.0 - s.scores["Firm"]) for s in front]
    assert scores == sorted(scores, reverse=True)


def test_of_two_high_scores_more_of_both_is_better():
    formula = lambda setting, _: {  # noqa: E731
        "IDF1": setting["a"], "Recovery": setting["b"], "Ambiguous": 1 - setting["b"]
    }  # fmt: skip
    pairs = [(0.9, 0.8), (0.7, 0.0), (0.8, 0.9), (0.8, 0.7)]
    result = FakeBench(formula).run([{"a": a, "b": b} for a, b in pairs])
    for second in ("Recovery", "Ambiguous"):
        assert [one.index for one in result.pareto("IDF1", second)] == [0, 2]
    assert [one.index for one in result.pareto("Ambiguous", "IDF1")] == [2, 0]


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_settings_that_are_not_allowed_are_proposed_anew(sampler):
    formula = lambda setting, _: {"IDF1": setting.get("low", 0.0)}  # noqa: E731
    bench = FakeBench(formula)
    space = {"low": (0.0, 1.0), "high": (0.0, 1.0)}
    result = search(bench, space, number=40, at_once=8, sampler=sampler)
    assert len(result.settings) == 41
    assert not any(map(bench.find_fault, result.settings))
    with pytest.raises(SweepError, match="allowed: low is above high; give other ranges"):
        search(FakeBench(formula), {"low": (0.5, 1.0), "high": (0.0, 0.4)}, sampler=sampler)


def test_unknown_scores_teach_nothing_and_stop_nothing():
    def half_known(setting, scene):
        scores = hill(setting, scene)
        known = setting.get("matching.match", 0.5) < 0.8
        return {**scores, "IDF1": scores["IDF1"] if known else math.nan}

    result = search(FakeBench(half_known), SPACE, number=32, at_once=8)
    assert result.best()[0].scores["IDF1"] > 0.8


def test_interruption_keeps_what_was_found():
    result = search(FakeBench(hill, stop_after=2), SPACE, number=32, at_once=8)
    assert not result.complete
    assert len(result.settings) == 17


def test_what_cannot_be_searched_is_told():
    bench = FakeBench(hill)
    with pytest.raises(SweepError, match="no score 'IDF'"):
        search(bench, SPACE, objectives=("IDF",))
    with pytest.raises(SweepError, match="no sampler 'anneal'"):
        search(bench, SPACE, sampler="anneal")  # pyright: ignore[reportArgumentType]
    with pytest.raises(SweepError, match="no objective"):
        search(bench, SPACE, objectives=())
    with pytest.raises(SweepError, match="no thresholds"):
        search(bench, {})
    with pytest.raises(SweepError, match="has 1 value"):
        search(bench, {"matching.match": [0.5]})
    with pytest.raises(SweepError, match="give at least 1"):
        search(bench, SPACE, number=0)
    assert not bench.asked


def test_without_optuna_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(SweepError, match=r"pip install 'remind-jax\[sweep\]'"):
        search(FakeBench(hill), SPACE)
