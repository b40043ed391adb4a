import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.decision import Outcome, Reason, Status
from remind_jax.errors import OutputError
from remind_jax.files.records import decode_json
from remind_jax.outputs import run_records, store
from remind_jax.outputs.run_records import FrameRow
from remind_jax.outputs.writer import KeptTracks
from remind_jax.tracks import Tracks
from tests.outputs.fake_run import make_info, make_run, make_tracks


def assert_same(ours: Tracks, theirs: Tracks) -> None:
    for field in dataclasses.fields(Tracks):
        mine, other = getattr(ours, field.name), getattr(theirs, field.name)
        if field.name == "rles":
            np.testing.assert_array_equal(ours.masks, theirs.masks)
        else:
            np.testing.assert_array_equal(mine, other, err_msg=field.name)


scores = st.floats(-10, 10, width=32) | st.just(float("nan"))
rows = st.fixed_dictionaries(
    {
        "label": st.text(max_size=8),
        "outcome": st.sampled_from(list(Outcome)),
        "reason": st.sampled_from(list(Reason)),
        "status": st.sampled_from(list(Status)),
        "object_id": st.integers(-1, 10_000),
        "pending_id": st.integers(-1, 10_000),
        "instance_id": st.integers(-1, 10_000),
        "score": scores,
        "confidence": scores,
        "detector_score": scores,
        "candidates": st.lists(st.tuples(st.integers(0, 99), scores), max_size=3),
    }
)


@given(rows=st.lists(rows, max_size=5), seed=st.integers(0, 99))
@settings(max_examples=60, deadline=None)
def test_any_frame_survives_json(rows, seed):
    masks = np.random.default_rng(seed).random((len(rows), 9, 13)) < 0.3
    tracks = make_tracks(3, masks, rows)
    text = json.dumps(run_records.tracks_to_json(tracks), allow_nan=False)
    assert_same(run_records.tracks_of(decode_json(text.encode(), FrameRow, "a frame")), tracks)


def test_frames_kept_on_disk_come_back_while_more_are_added(tmp_path):
    frames = make_run(6)[1].tracks
    kept = KeptTracks(tmp_path)
    for tracks in frames[:3]:
        kept.append(tracks)
    assert len(list(kept)) == 3
    for tracks in frames[3:]:
        kept.append(tracks)
    for ours, theirs in zip(frames, kept, strict=True):
        assert_same(ours, theirs)
    assert list(tmp_path.iterdir()) == []  # the file has no name, so nothing is left


@pytest.fixture
def stored(tmp_path):
    _, result = make_run(num_frames=6)
    path = tmp_path / store.DETECTIONS_NAME
    with store.detections_writer(path, make_info()) as writer:
        for tracks in result.tracks:
            writer.add(tracks)
    return path, result


def test_frames_are_on_disk_before_the_file_is_closed(tmp_path):
    _, result = make_run(num_frames=3)
    path = tmp_path / store.DETECTIONS_NAME
    writer = store.detections_writer(path, make_info())
    for done, tracks in enumerate(result.tracks, start=1):
        writer.add(tracks)
        assert len(store.read_detections(path)[1]) == done
    writer.close()


@pytest.mark.parametrize("cut", [1, 40, 200])
def test_a_line_cut_off_at_the_end_is_left_out(stored, cut):
    path, result = stored
    path.write_bytes(path.read_bytes()[:-cut])
    info, frames = store.read_detections(path)
    assert info == make_info()
    assert len(frames) == 5
    assert_same(frames[-1], result.tracks[4])


def test_damage_in_the_middle_is_named_by_line(stored):
    path, _ = stored
    lines = path.read_bytes().splitlines(keepends=True)
    lines[3] = lines[3][:50] + b"\n"
    path.write_bytes(b"".join(lines))
    with pytest.raises(OutputError, match=r"line 4"):
        store.read_detections(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "holds no run"),
        (b'{"a": 1}\n', "not a file of detections"),
        (b"[1]\n", "not a file of detections"),
        (b'{"format": "remind-jax detections", "version": 99, "info": {}}\n', "version 99"),
    ],
)
def test_other_files_are_refused(tmp_path, content, message):
    path = tmp_path / store.DETECTIONS_NAME
    path.write_bytes(content)
    with pytest.raises(OutputError, match=message):
        store.read_detections(path)


def test_run_json_is_readable_and_atomic(tmp_path):
    path = tmp_path / store.RUN_NAME
    content = {"a": [1, 2.5, -3e-7], "b": {"c": "[ 1,\n 2 ]"}, "d": []}
    store.write_run_json(path, content)
    assert '"a": [1, 2.5, -3e-07]' in path.read_text()
    assert json.loads(path.read_text()) == content
    with pytest.raises(TypeError):
        store.write_run_json(path, {"a": object()})
    assert [p.name for p in tmp_path.iterdir()] == [store.RUN_NAME]
    assert json.loads(path.read_text()) == content


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c.update(frame=0), "line 4 is of frame 0 after frame 1"),
        (lambda c: c.update(frame=10**9), "line 4.*frame"),
        (lambda c: c.update(size=[0, 64]), r"line 4.*size\[0\]"),
        (lambda c: c.update(size=[7, 9]), "the mask of detection 0 in frame 2 is damaged"),
        (lambda c: c.update(num_candidates=0), "'num_candidates' is 0, which does not fit"),
        (lambda c: c["detections"][0].update(outcome="won"), "line 4.*outcome"),
        (lambda c: c["detections"][0].update(rle="\u00e9"), "its code is no ASCII text"),
        (lambda c: c["detections"][0].update(score=float("nan")), "line 4"),
        (lambda c: c["detections"][0].update(object_id=2**40), "line 4.*object_id"),
        (lambda c: c["detections"][0].update(box=[1, 2, 3]), "line 4.*box"),
        (lambda c: c["detections"][0].pop("label"), "line 4.*`label`"),
    ],
)
def test_what_is_wrong_in_a_frame_is_named(stored, change, said):
    path, _ = stored
    lines = path.read_text().splitlines(keepends=True)
    content = json.loads(lines[3])
    change(content)
    lines[3] = json.dumps(content) + "\n"
    path.write_text("".join(lines))
    with pytest.raises(OutputError, match=said):
        store.read_detections(path)
