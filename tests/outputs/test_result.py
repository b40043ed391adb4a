import dataclasses
import itertools
import json
import sys
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.decision import Outcome
from remind_jax.errors import OptionError, OutputError
from remind_jax.metrics.run_folder import read_tracks
from remind_jax.outputs.presence import ObjectHistory, join_positions
from remind_jax.outputs.report import report_data, spans_with
from remind_jax.outputs.result import Result
from remind_jax.outputs.run_records import RunInfo
from tests.outputs.fake_run import make_info, make_run, make_tracks


def run_of_presence(*presence: str) -> Result:
    """A run from one string per object, `x` where it is seen; object 0 is the first string."""
    tracks = []
    for index in range(len(presence[0])):
        rows = [{"object_id": i} for i, seen in enumerate(presence) if seen[index] == "x"]
        masks = np.ones((len(rows), 8, 8), bool)
        tracks.append(make_tracks(index, masks, rows))
    return Result(tuple(tracks), make_info(size=(8, 8)))


def test_info_names_what_is_wrong():
    wrong = {
        "frame_size": [[48], [48, 0]],
        "fps": [float("nan"), -1],
        "config": [{}, {"tracker": [1]}, [1]],
        "class_names": ["cup"],
        "backbone": [None],
    }
    for name, values in wrong.items():
        for value in values:
            with pytest.raises(OutputError, match=f"description of the run.*{name}"):
                RunInfo.from_json(make_info().to_json() | {name: value})
    content = make_info().to_json()
    del content["backbone"]
    with pytest.raises(OutputError, match=r"description of the run: .*`backbone`"):
        RunInfo.from_json(content)


def test_run_json_names_what_is_wrong(tmp_path):
    _, result = make_run(3, (48, 64), 2)
    result.save(tmp_path)
    path = tmp_path / "run.json"
    good = json.loads(path.read_text())
    wrong = {
        "timings_ms": [{"step": [1.0, "2"]}, {"step": [float("nan")]}, [1.0]],
        "complete": [1],
        "skipped": [[{"name": "x"}]],
        "events": [[{"frame_index": 0.5}]],
        "info": [{}],
    }
    for name, values in wrong.items():
        for value in values:
            path.write_text(json.dumps(good | {name: value}))
            with pytest.raises(OutputError, match=r"run\.json'.* or delete the file to"):
                Result.load(tmp_path)


def test_objects_know_absences_and_returns():
    result = run_of_presence("xx.....xx....x", ".............x")
    first, second = result.objects()
    assert (first.first_frame, first.last_frame, first.num_frames) == (0, 13, 5)
    assert first.absences == ((2, 6),)  # the gap of four frames is flicker
    assert first.returns == (7,)
    assert (second.first_frame, second.absences, second.returns) == (13, (), ())
    for wrong in ("a", -1):
        with pytest.raises(OptionError, match=r"'min_absence_frames' is .* a whole number from 1"):
            result.objects(wrong)


def test_absences_use_frame_numbers():
    result = run_of_presence("x.....x")
    renumbered = tuple(
        dataclasses.replace(tracks, frame_index=10 * tracks.frame_index) for tracks in result.tracks
    )
    (history,) = dataclasses.replace(result, tracks=renumbered).objects()
    assert history.absences == ((10, 50),)
    assert history.returns == (60,)


def test_summary_counts():
    _, result = make_run()
    summary = result.summary()
    num_detections = sum(len(tracks) for tracks in result.tracks)
    assert summary["frames"] == 40
    assert summary["identities"] == 6
    assert summary["returns"] == 3
    assert summary["detections"] == num_detections
    assert summary["skipped_frames"] == 1
    assert summary["repeated_identities"] == 0
    assert summary["undecided_share"] == pytest.approx(4 / num_detections)
    assert sum(summary["outcome_shares"].values()) == pytest.approx(1)
    assert summary["ms_per_frame"]["step"]["median"] == np.median(result.timings_ms["step"])
    json.dumps(summary, allow_nan=False)


def test_summaries_of_an_identity_given_twice_and_of_nothing():
    masks = np.ones((2, 8, 8), bool)
    tracks = make_tracks(0, masks, [{"object_id": 3}, {"object_id": 3}])
    assert Result((tracks,), make_info()).summary()["repeated_identities"] == 1
    summary = Result((), make_info()).summary()
    assert (summary["frames"], summary["identities"], summary["undecided_share"]) == (0, 0, 0)


def test_saved_run_is_loaded_whole(tmp_path):
    _, result = make_run()
    result.save(tmp_path / "deep" / "run")
    loaded = Result.load(tmp_path / "deep" / "run")
    assert loaded.info == result.info
    assert loaded.skipped == result.skipped
    assert loaded.events == result.events
    assert loaded.complete
    assert loaded.memory == result.memory
    assert (loaded.first_frame_ms, loaded.compile_s) == (812.5, 6.25)
    # Times are written to a microsecond.
    np.testing.assert_allclose(loaded.timings_ms["step"], result.timings_ms["step"], atol=5e-4)
    assert loaded.objects() == result.objects()
    for ours, theirs in zip(loaded.tracks, result.tracks, strict=True):
        np.testing.assert_array_equal(ours.masks, theirs.masks)


@pytest.mark.parametrize("is_complete", [True, False])
def test_a_record_cut_off_since_is_refused(tmp_path, is_complete):
    """`run.json` counts the frames of a run that is complete."""
    _, result = make_run()
    dataclasses.replace(result, complete=is_complete).save(tmp_path)
    path = tmp_path / "detections.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]) + lines[-1][:40])
    if is_complete:
        said = rf"holds {len(lines) - 2} frames, and 'run.json' beside it counts {len(lines) - 1}"
        for read in (Result.load, read_tracks):
            with pytest.raises(OutputError, match=said):
                read(tmp_path)
    else:
        assert len(Result.load(tmp_path)) == len(read_tracks(tmp_path)) == len(lines) - 2


def test_class_names_include_unannounced_ones():
    tracks = make_tracks(0, np.ones((1, 8, 8), bool), [{"label": "zebra"}])
    info = dataclasses.replace(make_info(), class_names=("cup",))
    assert Result((tracks,), info).class_names == ("cup", "zebra")


def test_dataframe_has_a_row_per_detection():
    pytest.importorskip("pandas")
    _, result = make_run()
    frame = result.to_dataframe()
    assert len(frame) == sum(len(tracks) for tracks in result.tracks)
    assert set(frame.loc[frame.object_id == 1, "label"]) == {"cup"}
    assert (frame.outcome == "ambiguous").sum() == 3
    empty = Result(result.tracks[:0], result.info).to_dataframe()
    assert frame.dtypes[["score", "confidence"]].equals(empty.dtypes[["score", "confidence"]])


def test_supervision_gets_a_frame_with_the_classes_of_the_run():
    pytest.importorskip("supervision")
    _, result = make_run()
    tracks, detections = result.tracks[26], result.to_supervision(26)
    np.testing.assert_array_equal(detections.tracker_id, tracks.object_id)
    assert [result.class_names[i] for i in detections.class_id] == list(tracks.labels)
    with pytest.raises(OutputError, match="frame 40 was asked for, but the run has 40 frames"):
        result.to_supervision(40)
    assert len(make_tracks(0, np.zeros((0, 8, 8), bool), []).to_supervision()) == 0


@pytest.mark.parametrize(
    ("module", "call", "advice"),
    [
        ("supervision", lambda r: r.to_supervision(0), r'pip install "remind-jax\[viz\]"'),
        ("pandas", lambda r: r.to_dataframe(), "pip install pandas"),
    ],
)
def test_missing_library_is_named(monkeypatch, module, call, advice):
    _, result = make_run(num_frames=2)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(OutputError, match=advice):
        call(result)


def test_rows_follow_first_sight():
    _, result = make_run(30)
    late_first = dataclasses.replace(result, tracks=result.tracks[10:])  # 1, 3, 5 come back at 20
    shown = report_data(late_first, [], None)["identities"]
    assert [row["id"] for row in shown] == [0, 2, 4, 3, 5, 1]


def test_runs_absences_and_doubt():
    _, result = make_run(30)
    rows = result.objects()
    row = rows[1]
    assert row.seen == ((0, 9), (23, 29))
    assert row.absences == ((10, 22),)
    assert row.returns == (23,)
    assert row.candidate == ((20, 22),)
    assert rows[0].candidate == ((20, 22),)
    assert rows[4].absences == ()  # one frame is flicker
    assert spans_with(result, Outcome.AMBIGUOUS) == ((20, 22),)
    assert spans_with(result, Outcome.PROVISIONAL_NEW) == ((20, 20),)


@given(st.lists(st.integers(0, 60)))
def test_spans_hold_all_positions_and_touch_nowhere(positions):
    spans = join_positions(sorted(positions))
    assert [p for first, last in spans for p in range(first, last + 1)] == sorted(set(positions))
    assert all(one[1] + 1 < other[0] for one, other in itertools.pairwise(spans))


def test_returns_of_a_long_recording_are_found_at_once():
    """Each absence was looked up among all visits: 20,000 of them took 20 s."""
    starts = range(0, 400_000, 20)
    absences = tuple((start + 10, start + 19) for start in starts[:-1])
    seen = tuple((start, start + 9) for start in starts)
    history = ObjectHistory(0, "cup", "cup 0", 10 * len(starts), seen, (), absences)
    begun = time.process_time()
    assert history.returns == tuple(starts[1:])
    assert time.process_time() - begun < 2


def test_an_identity_has_the_class_of_most_of_its_detections():
    labels = ("bowl", "cup", "cup", "vase")
    masks = np.ones((1, 8, 8), bool)
    run = [make_tracks(i, masks, [{"object_id": 0, "label": one}]) for i, one in enumerate(labels)]
    (history,) = Result(tuple(run), make_info()).objects()
    assert (history.label, history.title) == ("cup", "cup 0")
