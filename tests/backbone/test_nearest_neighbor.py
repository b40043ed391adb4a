import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def benchmark_module(monkeypatch) -> ModuleType:
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("nearest_neighbor")


def make_sightings(module: ModuleType, frames, instances, labels=None):
    labels = ["thing"] * len(frames) if labels is None else labels
    unused = np.zeros((1, 16, 16, 3), np.uint8)
    columns = (np.zeros(len(frames), int), np.array(frames), np.array(instances), np.array(labels))
    return module.Sightings("made", unused, [], *columns)


def test_rank_one_asks_only_what_can_be_answered(benchmark_module):
    sightings = make_sightings(benchmark_module, [0, 40, 40, 40], [1, 1, 2, 3])
    vectors = np.array([[1, 0], [0.8, 0.6], [0.6, 0.8], [1, 0]])
    assert benchmark_module.rank_one(vectors, sightings, 30) == (0.5, 2)
    assert benchmark_module.rank_one(vectors, sightings, 100) == (None, 0)


def test_cosines_are_sorted_by_kind_and_distance(benchmark_module):
    sightings = make_sightings(benchmark_module, [0, 10, 40], [1, 2, 1], ["cup", "cup", "cup"])
    vectors = np.array([[1, 0], [0, 1], [0.6, 0.8]])
    cosines = benchmark_module.cosine_percentiles(vectors, sightings)
    assert cosines == {
        "near class": [0.0] * 3,
        "far same": [0.6] * 3,
        "far class": [0.8] * 3,
    }
