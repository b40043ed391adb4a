"""The whole benchmark on two tiny tours: kept, resumed, failed, scored, written."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import shutil
from typing import TypeVar

import numpy as np
import pytest

from remind_jax.backbone.registry import get_backbone
from remind_jax.benchmark import running
from remind_jax.benchmark.contenders import all_contenders, make_contenders
from remind_jax.benchmark.memory_use import peak_rss_mib, reset_peak
from remind_jax.benchmark.paper import paper_rows
from remind_jax.benchmark.records import Record, Timing, folder_of, read_record, write_record
from remind_jax.benchmark.running import Setup, run_all
from remind_jax.benchmark.scenes import find_scenes
from remind_jax.benchmark.scoring import Scored, read_truth, score, summarise
from remind_jax.benchmark.tables import axis_table, list_failures, main_table, save_tables
from remind_jax.cli.main import main
from remind_jax.errors import ConfigError
from remind_jax.metrics import evaluate_tracks
from remind_jax.outputs.result import Result
from remind_jax.session import announcement

T = TypeVar("T")
METHODS = ("bank", "iou")  # quick to compile


@pytest.fixture
def setup(tmp_path) -> Setup:
    return Setup(
        out=tmp_path / "out",
        backbone=get_backbone("patch-statistics"),
        feature_cache=tmp_path / "features",
    )


def run(setup, scenes, methods=METHODS):
    """Records, and the runs that were not there yet."""
    new = []

    def report(record, was_there):
        if not was_there:
            new.append((record.scene, record.contender))

    return run_all(setup, scenes, make_contenders(methods), report), new


def given(value: T | None) -> T:
    """What must be there."""
    assert value is not None
    return value


def test_results_are_kept_and_nothing_is_done_twice(setup, dataset, monkeypatch):
    scenes = find_scenes(dataset)
    records, new = run(setup, scenes)
    assert new == [(scene.name, method) for scene in scenes for method in METHODS]
    assert all(record.status == "done" and record.num_frames == 8 for record in records)
    assert all(given(record.step).mean_ms <= given(record.frame).mean_ms for record in records)
    assert all(given(r.frame_compiling).mean_ms > given(r.frame).mean_ms for r in records)
    assert all(record.peak_rss_mib > 50 for record in records)
    num_features = len(list(setup.feature_cache.rglob("*.npy")))
    assert num_features == 16  # one file per frame, whatever the number of methods

    again, new = run(setup, scenes)
    assert again == records
    assert new == []
    # Another setting is another result; whoever has results keeps them.
    _, new = run(dataclasses.replace(setup, sampling=running.Sampling(stride=2)), scenes, ("iou",))
    assert new == [("alike-1", "iou"), ("light-1", "iou")]


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
    table = main_table(runs, {}, "masks")
    assert table.rows[0].note == "1 of 2 scenes failed"
    assert list_failures(runs)[0].startswith("iou on alike-1: ")

    _, new = run(setup, scenes, ("iou",))
    assert new == []
    _, new = run(dataclasses.replace(setup, retry_failed=True), scenes, ("iou",))
    assert new == [("alike-1", "iou")]


def test_scores_are_those_of_the_run(setup, dataset):
    scene = find_scenes(dataset)[0]
    (record,), _ = run(setup, (scene,), ("bank",))
    scored = score(setup.out, record, read_truth(scene))
    tracks = Result.load(folder_of(setup.out, "masks", "bank", scene.name)).tracks
    expected = evaluate_tracks(tracks).scores()
    scores, intervals = summarise([scored])
    assert intervals == {}  # one scene tells nothing about the spread of scenes
    for name in ("IDF1", "HOTA", "AssA", "IDSW", "IDs"):
        assert scores[name] == pytest.approx(expected[name], abs=1e-12)
    assert scores["IDF1Settled"] == scores["IDF1"]  # a baseline is never undecided
    assert scores["step_ms"] == pytest.approx(given(record.step).mean_ms)


def test_a_detector_is_scored_against_the_annotations(setup, dataset, tmp_path, monkeypatch):
    scene = find_scenes(dataset)[0]
    truth = {frame.name: frame.detections for frame in scene.open()}
    by_image = {given(f.image).tobytes(): given(truth[f.name]) for f in scene.open()}

    def find_half(image):
        found = by_image[image.tobytes()]
        return found.select(np.arange(0, len(found), 2))

    found = dataclasses.replace(setup, regime="detector", detector=find_half)
    monkeypatch.setattr(running, "_describe_detector", lambda setup: "half")
    # The scene is too short for objects that wait to be announced.
    monkeypatch.setattr(announcement, "DETECTOR_DEFAULT", 1)
    (record,), _ = run(found, (scene,), ("bank",))
    assert record.status == "done", record.error
    scored = score(found.out, record, read_truth(scene))
    num_truth = sum(len(d) for d in by_image.values())
    num_found = sum((len(d) + 1) // 2 for d in by_image.values())
    scores = given(scored.strict).scores()
    assert scores["GT_Dets"] == num_truth
    assert scores["CLR_FN"] == num_truth - num_found


def test_records_come_back_as_they_were(tmp_path):
    record = Record(
        "bank",
        "room",
        "masks",
        "abc",
        "done",
        "",
        9,
        Timing(3.0, 4.0),
        None,
        Timing(1.0, 2.0),
        80.5,
    )
    write_record(tmp_path, record)
    back = given(read_record(tmp_path))
    assert math.isnan(back.device_mib)
    assert dataclasses.replace(back, device_mib=0.0) == dataclasses.replace(record, device_mib=0.0)
    (tmp_path / "record.json").write_text('{"contender": "bank"}')
    assert read_record(tmp_path) is None


def test_times_are_means_over_frames_and_memory_is_the_largest(setup, dataset):
    scene = find_scenes(dataset)[0]
    (record,), _ = run(setup, (scene,), ("iou",))
    scored = score(setup.out, record, read_truth(scene))

    def with_(frames, ms, mib):
        changed = dataclasses.replace(
            record, num_frames=frames, step=Timing(ms, ms), peak_rss_mib=mib
        )
        return dataclasses.replace(scored, record=changed)

    scores, _ = summarise([with_(10, 1.0, 100.0), with_(30, 5.0, 90.0)])
    assert scores["step_ms"] == pytest.approx(4.0)
    assert scores["peak_rss_mib"] == 100.0
    assert scores["GT_IDs"] == 2 * given(scored.strict).scores()["GT_IDs"]
    _, intervals = summarise([scored] * 5)
    low, high = intervals["IDF1"]
    assert low == pytest.approx(high)  # equal scenes have no spread


def test_peak_memory_can_start_anew():
    # Anything that the allocator gives back at once; so large that nothing else hides it.
    block = bytearray(300 * 2**20)
    high = peak_rss_mib()
    del block
    if not reset_peak():
        pytest.skip("this system cannot reset the peak")
    assert peak_rss_mib() < high - 200


def test_contenders_by_name(tmp_path):
    names = all_contenders()
    assert names[:3] == ["default", "remind", "published"]
    assert {"ablation_greedy", "momentum", "running-mean", "bank", "iou"} <= set(names)
    assert "plus" not in names  # it is the default
    mine = tmp_path / "mine.yaml"
    mine.write_text("base: remind\nthresholds: {matching: {match: 0.5}}\n")
    (contender,) = make_contenders([str(mine)])
    assert contender.name == "mine"
    assert contender.config.thresholds.matching.match == 0.5
    with pytest.raises(ConfigError, match=r"no method 'bnak'.*'bank'"):
        make_contenders(["bnak"])
    ablations = make_contenders(["ablation_no_parts", "ablation_plus_no_layout"])
    assert [one.title for one in ablations] == ["remind: no parts", "plus: no layout"]
    assert len({one.title for one in make_contenders()}) == len(names)


@pytest.mark.parametrize("regime", ["masks", "detector"])
@pytest.mark.parametrize("data", ["custom", "scannetpp"])
def test_the_papers_numbers_stand_beside_ours(data, regime):
    rows = {row.name: row.scores for row in paper_rows(data, regime)}
    assert {"paper: DAM4SAM", "paper: MASA", "paper: REMIND"} <= set(rows)
    values = [
        v for scores in rows.values() for k, v in scores.items() if not k.endswith(("ms", "b"))
    ]
    assert all(math.isnan(value) or 0 < value < 1 for value in values)
    # F1 follows from precision and recall, but for the rounding of the paper's tables.
    scores = rows["paper: REMIND"]
    harmonic = 2 / (1 / scores["IDP"] + 1 / scores["IDR"])
    assert scores["IDF1"] == pytest.approx(harmonic, abs=1e-4)
    table = main_table([], {}, regime, paper=data)
    assert "definitions" in table.legend[-1]
    assert "IDR" in table.to_markdown()


def test_other_scenes_have_no_table_by_difficulty(tmp_path):
    record = Record("iou", "kitchen", "masks", "", "failed", "no")
    assert axis_table([Scored(record)], {}) is None
    saved = save_tables({"masks": main_table([Scored(record)], {}, "masks")}, tmp_path / "tables")
    assert {path.suffix for path in saved} >= {".md", ".csv", ".tex", ".txt"}


def test_the_command_writes_tables_and_tells_numbers(dataset, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    words = ["benchmark", str(dataset), "--methods", "iou", "--out", str(out), "--json"]
    words += ["--feature-cache", str(tmp_path / "features")]
    assert main(words) == 0
    printed = capsys.readouterr()
    scores = json.loads(printed.out)["scores"]["IoU"]
    assert 0 < scores["IDF1"] < 1
    assert "alike-1, iou: 8 frames" in printed.err
    with (out / "tables" / "masks.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert float(row["IDF1"]) == pytest.approx(scores["IDF1"])
    assert "| alike | light |" in (out / "tables" / "masks_axes.md").read_text()

    assert main([*words[:-3], "--quiet", "--scenes", "light-1"]) == 0
    assert capsys.readouterr().err == ""


def test_without_annotations_there_is_nothing_to_score(dataset, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(dataset / "alike-1", copy)
    shutil.rmtree(copy / "Annotations")
    assert main(["benchmark", str(copy), "--methods", "iou", "--out", str(tmp_path / "out")]) == 1
    assert "nothing can be scored" in capsys.readouterr().err
