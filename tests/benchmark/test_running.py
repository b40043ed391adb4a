"""What is run, kept, resumed and counted as failed, on two tiny tours."""

import dataclasses
import functools
import shutil

import pytest

from remind_jax import method as methods
from remind_jax.benchmark import running
from remind_jax.benchmark.records import folder_of
from remind_jax.benchmark.running import peak_rss_mib, reset_peak
from remind_jax.benchmark.scenes import find_scenes
from remind_jax.benchmark.scoring import read_truth, score, score_scene
from remind_jax.benchmark.tables import list_failures, make_tables
from remind_jax.method import get_method
from tests.benchmark.conftest import METHODS, run


def test_results_are_kept_and_nothing_is_done_twice(setup, dataset, monkeypatch):
    scenes = find_scenes(dataset)
    records, new = run(setup, scenes)
    assert new == [(scene.name, method) for scene in scenes for method in METHODS]
    assert all(record.status == "done" and record.num_frames == 8 for record in records)
    times = [record.times_ms for record in records]
    assert all(ms["step_ms"] <= ms["frame_ms"] < ms["compiling_ms"] for ms in times)
    assert all((record.peak_rss_mib or 0) > 50 for record in records)
    num_features = len(list(setup.feature_cache.rglob("*.npy")))
    assert num_features == 16  # one file per frame, whatever the number of methods

    again, new = run(setup, scenes)
    assert again == records
    assert new == []
    # Another setting is another result; whoever has results keeps them.
    _, new = run(dataclasses.replace(setup, sampling=running.Sampling(stride=2)), scenes, ("iou",))
    assert new == [("alike-1", "iou"), ("light-1", "iou")]


@pytest.mark.parametrize(
    "changed",
    [
        "data/alike-1/JPEGImages/*/*.jpg",
        "data/alike-1/Annotations/*/*.png",
        "data/alike-1/meta*.json",
        "detector.onnx",
        "detector.onnx.data",
    ],
)
def test_other_content_under_the_same_names_is_another_result(setup, dataset, tmp_path, changed):
    shutil.copytree(dataset / "alike-1", tmp_path / "data" / "alike-1")
    detector = tmp_path / "detector.onnx"
    detector.write_bytes(b"none, so that runs fail soon\n\x08location\x12\x12detector.onnx.data")
    detector.with_name("detector.onnx.data").write_bytes(b"numbers")
    setup = dataclasses.replace(setup, detector=detector)
    _, new = run(setup, find_scenes(dataset)[:1], ("iou",))
    assert new == [("alike-1", "iou")]
    assert run(setup, find_scenes(tmp_path / "data"), ("iou",))[1] == []  # a copy is the same
    file = next(tmp_path.glob(changed))
    content = file.read_bytes()
    file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert run(setup, find_scenes(tmp_path / "data"), ("iou",))[1] == new


def test_another_own_method_of_the_same_name_is_another_result(setup, dataset, monkeypatch):
    package, scenes = get_method("iou"), find_scenes(dataset)[:1]
    monkeypatch.setattr(running, "run", lambda source, **options: 1 / 0)  # fails soon
    for value, is_new in ((1, True), (1, False), (2, True)):
        own = dataclasses.replace(package, decide=functools.partial(package.decide, own=value))
        monkeypatch.setitem(methods._methods, "iou", own)
        assert run(setup, scenes, ("iou",))[1] == [("alike-1", "iou")] * is_new


def test_a_result_that_is_lost_is_made_again_and_one_cut_off_has_failed(setup, dataset):
    scenes = find_scenes(dataset)[:1]
    (record,), _ = run(setup, scenes, ("iou",))
    file = folder_of(setup.out, "masks", "iou", "alike-1") / "detections.jsonl"
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(lines[:5]))
    scored = score(setup.out, record, read_truth(scenes[0]))
    assert scored.strict is None
    assert "holds 4 frames" in scored.error
    file.unlink()
    assert run(setup, scenes, ("iou",))[1] == [("alike-1", "iou")]
    assert file.read_bytes().splitlines()[1:] == [line.rstrip() for line in lines[1:]]


def test_an_interruption_costs_the_run_in_work(setup, dataset, monkeypatch):
    scenes = find_scenes(dataset)
    real_run = running.run

    def stop_at_the_second(source, **options):
        if options["config"].tracker == "iou":
            raise KeyboardInterrupt
        return real_run(source, **options)

    monkeypatch.setattr(running, "run", stop_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        run(setup, scenes)
    monkeypatch.undo()
    _, new = run(setup, scenes)
    assert ("alike-1", "bank") not in new
    assert len(new) == 3


def test_a_run_that_kills_the_process_is_not_tried_again(setup, dataset, monkeypatch):
    def die(source, **options):
        raise SystemExit  # as good as a kill: nothing that follows is run

    scenes = find_scenes(dataset)[:1]
    monkeypatch.setattr(running, "run", die)
    for _ in range(2):  # once may have been chance, so it is tried again
        with pytest.raises(SystemExit):
            run(setup, scenes, ("iou",))
    monkeypatch.undo()
    (record,), new = run(setup, scenes, ("iou",))
    assert new == []
    assert record.status == "failed"
    assert "the process ended" in record.error


def test_a_run_that_fails_is_counted_and_the_others_go_on(setup, dataset, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(dataset, broken)
    for file in (broken / "alike-1" / "JPEGImages").rglob("*.jpg"):
        file.write_bytes(b"no picture")
    scenes = find_scenes(broken)
    records, _ = run(setup, scenes, ("iou",))
    assert [record.status for record in records] == ["failed", "done"]
    assert "none of the 8 frames" in records[0].error
    truths = [read_truth(find_scenes(dataset)[i]) for i in range(2)]
    runs = [score(setup.out, r, t) for r, t in zip(records, truths, strict=True)]
    table = make_tables(runs, {}, "masks")["masks"]
    assert table.rows[0].note == "1 of 2 scenes failed"
    assert list_failures(runs)[0].startswith("iou on alike-1: ")

    _, new = run(setup, scenes, ("iou",))
    assert new == []
    _, new = run(dataclasses.replace(setup, retry_failed=True), scenes, ("iou",))
    assert new == [("alike-1", "iou")]


def test_truth_that_cannot_be_read_costs_its_scene_only(setup, dataset, tmp_path):
    """A run of a detector is done then all the same; and a skipped frame is told."""
    broken = tmp_path / "broken"
    shutil.copytree(dataset, broken)
    next((broken / "light-1" / "JPEGImages").rglob("*.jpg")).write_bytes(b"no picture")
    scenes = find_scenes(broken)
    records, _ = run(setup, scenes, ("iou",))
    for file in (broken / "alike-1" / "Annotations").rglob("*.png"):
        file.write_bytes(b"no picture")
    runs = [
        one for s, r in zip(scenes, records, strict=True) for one in score_scene(setup.out, [r], s)
    ]
    assert [run.strict is None for run in runs] == [True, False]
    assert "no instance maps that can be used" in runs[0].error
    table = make_tables(runs, {}, "masks")["masks"]
    assert table.rows[0].note == "1 of 2 scenes failed; 1 frame skipped"


def test_peak_memory_can_start_anew():
    # Anything that the allocator gives back at once; so large that nothing else hides it.
    block = bytearray(300 * 2**20)
    high = peak_rss_mib()
    del block
    if not reset_peak():
        pytest.skip("this system cannot reset the peak")
    assert peak_rss_mib() < high - 200
