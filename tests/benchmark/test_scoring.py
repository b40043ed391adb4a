import dataclasses

import numpy as np
import pytest

from remind_jax.benchmark import running
from remind_jax.benchmark.records import folder_of
from remind_jax.benchmark.scenes import find_scenes
from remind_jax.benchmark.scoring import read_truth, score, summarize
from remind_jax.metrics import evaluate_tracks
from remind_jax.outputs.result import Result
from remind_jax.session import announcement
from tests.benchmark.conftest import run


def test_scores_are_those_of_the_run(setup, dataset):
    scene = find_scenes(dataset)[0]
    (record,), _ = run(setup, (scene,), ("bank",))
    scored = score(setup.out, record, read_truth(scene))
    tracks = Result.load(folder_of(setup.out, "masks", "bank", scene.name)).tracks
    expected = evaluate_tracks(tracks).scores()
    scores, intervals = summarize([scored])
    assert intervals == {}  # one scene tells nothing about the spread of scenes
    for name in ("IDF1", "HOTA", "AssA", "IDSW", "IDs"):
        assert scores[name] == pytest.approx(expected[name], abs=1e-12)
    assert scores["IDF1Settled"] == scores["IDF1"]  # a baseline is never undecided
    assert scores["step_ms"] == pytest.approx(record.times_ms["step_ms"])


def test_a_detector_is_scored_against_the_annotations(setup, dataset, tmp_path, monkeypatch):
    scene = find_scenes(dataset)[0]
    truth = {frame.name: frame.detections for frame in scene.open()}
    by_image = {f.image.tobytes(): truth[f.name] for f in scene.open()}

    def find_half(image):
        found = by_image[image.tobytes()]
        return found.select(np.arange(0, len(found), 2))

    found = dataclasses.replace(setup, detector=find_half)
    monkeypatch.setattr(running, "_describe_detector", lambda setup: "half")
    # The scene is too short for objects that wait to be announced.
    monkeypatch.setattr(announcement, "DETECTOR_DEFAULT", 1)
    (record,), _ = run(found, (scene,), ("bank",))
    assert record.status == "done", record.error
    scored = score(found.out, record, read_truth(scene))
    num_truth = sum(len(d) for d in by_image.values())
    num_found = sum((len(d) + 1) // 2 for d in by_image.values())
    scores = scored.strict.scores()
    assert scores["GT_Dets"] == num_truth
    assert scores["CLR_FN"] == num_truth - num_found


def test_times_are_means_over_frames_and_memory_is_the_largest(setup, dataset):
    scene = find_scenes(dataset)[0]
    (record,), _ = run(setup, (scene,), ("iou",))
    scored = score(setup.out, record, read_truth(scene))

    def with_(frames, ms, mib):
        changed = dataclasses.replace(
            record, num_frames=frames, times_ms={"step_ms": ms}, peak_rss_mib=mib
        )
        return dataclasses.replace(scored, record=changed)

    scores, _ = summarize([with_(10, 1.0, 100.0), with_(30, 5.0, 90.0)])
    assert scores["step_ms"] == pytest.approx(4.0)
    assert scores["peak_rss_mib"] == 100.0
    assert scores["GT_IDs"] == 2 * scored.strict.scores()["GT_IDs"]
    _, intervals = summarize([scored] * 5)
    low, high = intervals["IDF1"]
    assert low == pytest.approx(high)  # equal scenes have no spread
