"""The trace of a run as a file."""

import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.errors import OutputError
from remind_jax.explanation import archive as module
from remind_jax.explanation.archive import TRACE_NAME, TraceArchive
from remind_jax.explanation.explainer import open_archive
from remind_jax.explanation.plus import PlusRecord
from remind_jax.explanation.remind.explainer import FrameRecord
from tests.explanation.scenes import decide_frame

ROWS = ([{0: 0.91, 1: 0.85}], [{}], [{0: 0.88, 1: 0.80}, {0: 0.87, 1: 0.76}])


NAMES = {0: "mug", 1: "Teetasse ☕"}


def new_archive(path=None):
    return TraceArchive("remind", FrameRecord, path)


@pytest.fixture(scope="module")
def archive():
    """Three frames with detections and one without."""
    filled = new_archive()
    for number, rows in enumerate((*ROWS, [])):
        filled.add(number, decide_frame(rows), NAMES)
    return filled


def test_what_is_read_is_what_was_written(archive, tmp_path):
    archive.save(tmp_path / TRACE_NAME)
    read = open_archive(tmp_path, "remind")
    assert read is not None
    assert read.labels == NAMES
    assert read.frame(4) is None
    new_archive(tmp_path / TRACE_NAME).save(tmp_path / "again.npz")
    for kept in (read, new_archive(tmp_path / "again.npz")):
        for number in range(4):
            before, after = archive.frame(number), kept.frame(number)
            for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
                np.testing.assert_array_equal(old, new)
                assert np.asarray(old).dtype == np.asarray(new).dtype


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
        valid=np.ones(1, bool),
    )
    one = dataclasses.replace(archive.frame(0), sets=dataclasses.replace(
        narrow, member_id=np.array([[5]], np.int32), detections=np.array([[True]])
    ))  # fmt: skip
    mixed = new_archive()
    mixed.add(0, one, NAMES)
    mixed.add(1, dataclasses.replace(wide, sets=narrow), NAMES)
    mixed.save(tmp_path / TRACE_NAME)
    first, second = (new_archive(tmp_path / TRACE_NAME).frame(i) for i in (0, 1))
    assert first is not None
    assert second is not None
    assert first.sets.member_id.tolist() == [[5]]
    assert second.sets.member_id.tolist() == [[3, 8]]
    assert second.sets.detections.tolist() == [[True, True]]


def test_the_file_is_read_when_asked_for(tmp_path):
    (tmp_path / TRACE_NAME).write_bytes(b"no archive")
    archive = open_archive(tmp_path, "remind")
    assert archive is not None
    with pytest.raises(OutputError, match=r"trace\.npz' is damaged"):
        archive.frame(0)
    with pytest.raises(OutputError, match="damaged"):
        archive.frame(0)  # and again, not an empty run


@pytest.mark.parametrize("version", [1, module.VERSION + 1])
def test_another_version_is_refused(archive, tmp_path, monkeypatch, version):
    monkeypatch.setattr(module, "VERSION", version)
    archive.save(tmp_path / TRACE_NAME)
    monkeypatch.undo()
    with pytest.raises(OutputError, match=rf"version {version}.*reads version {module.VERSION};"):
        new_archive(tmp_path / TRACE_NAME).frame(0)


def test_the_trace_of_another_tracker_is_refused(archive, tmp_path):
    archive.save(tmp_path / TRACE_NAME)
    with pytest.raises(OutputError, match="of tracker 'remind', not 'plus' as the run says"):
        TraceArchive("plus", PlusRecord, tmp_path / TRACE_NAME).frame(0)


def test_an_empty_run_can_be_kept(tmp_path):
    new_archive().save(tmp_path / TRACE_NAME)
    assert new_archive(tmp_path / TRACE_NAME).frame(0) is None


def test_a_run_without_trace_has_none(tmp_path):
    assert open_archive(tmp_path, "remind") is None


def test_other_ids_are_given_to_objects_and_not_to_tracks(archive):
    """New ids change places, so that each has to be looked up, padding stays."""
    new = {-1: -1, 0: 1, 1: 0}
    renumbered = archive.renumbered(lambda ids: {i: new.get(i, i) for i in ids})
    before, after = archive.frame(2), renumbered.frame(2)
    swap = np.vectorize(lambda i: new.get(i, i))
    for part, name in (
        ("decisions", "object_id"), ("stages", "assigned_id"), ("decisions", "option_id"),
    ):  # fmt: skip
        old, changed = (getattr(getattr(one, part), name) for one in (before, after))
        np.testing.assert_array_equal(swap(old), changed)
    np.testing.assert_array_equal(before.decisions.pending_id, after.decisions.pending_id)
    places = (before.detections.candidates.id, after.detections.candidates.id)
    np.testing.assert_array_equal(swap(places[0]), places[1])
    assert renumbered.labels == {1: "mug", 0: "Teetasse ☕"}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"decisions.score": np.zeros(3, np.float32)}, "its checksum is another one"),
        ({"label.name": np.array(["a"])}, "its checksum is another one"),
        ({"more": np.zeros(0)}, "its checksum is another one"),
        ({"version": np.array([1, 2])}, "damaged"),
        ({"tracker": np.array([{"a": 1}], object)}, "'tracker' is damaged"),
    ],
)
def test_what_is_not_as_it_was_written_is_refused(archive, tmp_path, changes, said):
    archive.save(tmp_path / TRACE_NAME)
    with np.load(tmp_path / TRACE_NAME) as file:
        arrays = dict(file)
    np.savez(tmp_path / TRACE_NAME, **{**arrays, **changes})
    with pytest.raises(OutputError, match=said):
        new_archive(tmp_path / TRACE_NAME).frame(0)
