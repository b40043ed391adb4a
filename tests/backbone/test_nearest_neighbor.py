import importlib
import json
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from remind_jax.backbone import get_backbone

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


def test_measures_a_folder_of_two_colored_squares(benchmark_module, tmp_path):
    folder = tmp_path / "squares"
    for kind in ("JPEGImages", "Annotations"):
        (folder / kind / "squares").mkdir(parents=True)
    (folder / "metadata.json").write_text(json.dumps({"id_to_class": {"1": "box", "2": "box"}}))
    for frame in range(41):
        image, labels = np.full((70, 100, 3), 90, np.uint8), np.zeros((70, 100), np.uint8)
        for instance, color in ((1, (40, 40, 200)), (2, (200, 90, 30))):
            left = 5 + frame // 4 + 45 * (instance - 1)
            image[20:50, left : left + 30] = color
            labels[20:50, left : left + 30] = instance
        cv2.imwrite(str(folder / "JPEGImages" / "squares" / f"{frame:05d}.jpg"), image)
        cv2.imwrite(str(folder / "Annotations" / "squares" / f"{frame:05d}.png"), labels)
    records = benchmark_module.measure(tmp_path, get_backbone())
    assert [record["dim"] for record in records] == [get_backbone().dim, 16 * 8 * 4]
    for record in records:
        assert record["rank_1"] == {"30": 1.0, "100": None}
        assert record["queries"] == {"30": 8, "100": 0}
