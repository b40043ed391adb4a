"""The trace of a run as a file."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.errors import OutputError
from remind_jax.explanation.plus.archive import PlusArchive
from remind_jax.explanation.remind.archive import TRACE_NAME, TraceArchive, open_archive
from tests.explanation.scenes import FRAME, decide_frame

ROWS = ([{0: 0.91, 1: 0.85}], [{}], [{0: 0.88, 1: 0.80}, {0: 0.87, 1: 0.76}])


def leaves(record):
    fields = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    return jax.tree.leaves(fields)


@pytest.fixture(scope="module")
def archive():
    """Three frames with detections and one without."""
    filled = TraceArchive()
    for number, rows in enumerate((*ROWS, [])):
        record = decide_frame(rows)
        filled._frames[number] = dataclasses.replace(record, frame_index=number)
    filled._labels = {0: "mug", 1: "Teetasse ☕"}
    return filled


def test_what_is_read_is_what_was_written(archive, tmp_path):
    archive.save(tmp_path / TRACE_NAME)
    read = open_archive(tmp_path)
    assert read is not None
    assert read.labels == archive.labels
    for number in range(4):
        before, after = archive.frame(number), read.frame(number)
        for old, new in zip(leaves(before), leaves(after), strict=True):
            np.testing.assert_array_equal(old, new)
            assert np.asarray(old).dtype == np.asarray(new).dtype
    assert read.frame(4) is None


def test_frames_of_grown_capacities_fit_in_one_file(archive, tmp_path):
    """More detection slots widen the sets of later frames."""
    wide = archive.frame(2)
    sets = wide.sets
    narrow = dataclasses.replace(
        sets,
        score=np.array([0.5], np.float32),
        member_id=np.array([[3, 8]], np.int32),
        detections=np.array([[True, True]]),
        coverage=np.ones(1, np.float32),
        density=np.ones(1, np.float32),
        maturity=np.ones(1, np.float32),
        valid=np.ones(1, bool),
    )
    one = dataclasses.replace(archive.frame(0), sets=dataclasses.replace(
        narrow, member_id=np.array([[5]], np.int32), detections=np.array([[True]])
    ))  # fmt: skip
    mixed = TraceArchive()
    mixed._frames = {0: one, 1: dataclasses.replace(wide, frame_index=1, sets=narrow)}
    mixed.save(tmp_path / TRACE_NAME)
    first, second = (TraceArchive.open(tmp_path / TRACE_NAME).frame(i) for i in (0, 1))
    assert first is not None
    assert second is not None
    assert first.set_members == [((5,), (0,))]
    assert second.set_members == [((3, 8), (0, 1))]


def test_the_file_is_read_when_asked_for(tmp_path):
    (tmp_path / TRACE_NAME).write_bytes(b"no archive")
    archive = open_archive(tmp_path)
    assert archive is not None
    with pytest.raises(OutputError, match=r"trace\.npz' is damaged.*run the tracker again with"):
        archive.frame(0)
    with pytest.raises(OutputError, match="damaged"):
        archive.frame(0)  # and again, not an empty run


def test_a_later_version_is_refused(archive, tmp_path, monkeypatch):
    monkeypatch.setattr(TraceArchive, "VERSION", 2)
    archive.save(tmp_path / TRACE_NAME)
    monkeypatch.undo()
    with pytest.raises(OutputError, match=r"version 2.*up to 1; upgrade remind-jax"):
        TraceArchive.open(tmp_path / TRACE_NAME).frame(0)


def test_the_trace_of_another_tracker_is_refused(archive, tmp_path):
    archive.save(tmp_path / TRACE_NAME)
    with pytest.raises(OutputError, match="of tracker 'remind', not 'plus' as the run says"):
        PlusArchive.open(tmp_path / TRACE_NAME).frame(0)


def test_what_was_opened_can_be_saved_again(archive, tmp_path):
    archive.save(tmp_path / TRACE_NAME)
    TraceArchive.open(tmp_path / TRACE_NAME).save(tmp_path / "again.npz")
    again = TraceArchive.open(tmp_path / "again.npz")
    for number in range(4):
        for old, new in zip(
            leaves(archive.frame(number)), leaves(again.frame(number)), strict=True
        ):
            np.testing.assert_array_equal(old, new)


def test_an_empty_run_can_be_kept(tmp_path):
    TraceArchive().save(tmp_path / TRACE_NAME)
    assert TraceArchive.open(tmp_path / TRACE_NAME).frame(0) is None


def test_a_run_without_trace_has_none(tmp_path):
    assert open_archive(tmp_path) is None


def test_frames_keep_their_number():
    assert decide_frame([{0: 0.9}]).frame_index == FRAME
