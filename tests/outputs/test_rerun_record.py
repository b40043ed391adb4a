"""Records are read back by Rerun's own reader."""

import collections
import dataclasses

import cv2
import numpy as np
import pytest
from rerun import chunk

from remind_jax.errors import OutputError
from remind_jax.outputs.rerun_record import RerunRecord
from tests.outputs.fake_run import make_run


@pytest.fixture(scope="module")
def run():
    return make_run()


@pytest.fixture(scope="module")
def rows(run, tmp_path_factory):
    """What was logged, by entity: one mapping from column to value for each row."""
    frames, result = run
    path = tmp_path_factory.mktemp("rerun") / "out.rrd"
    with RerunRecord(path, "kitchen tour") as record:
        for frame, tracks in zip(frames, result.tracks, strict=True):
            record.add(frame, tracks)
    logged = collections.defaultdict(list)
    for piece in chunk.RrdReader(path).stream().to_chunks():
        logged[str(piece.entity_path)] += piece.to_record_batch().to_pylist()
    return logged


def column(row, name):
    (key,) = (key for key in row if key.endswith(name))
    return row[key]


def test_every_frame_is_there(rows, run):
    frames, _ = run
    pictures = rows["/camera/image"]
    assert sorted(row["frame"] for row in pictures) == list(range(len(frames)))
    first = min(pictures, key=lambda row: row["frame"])
    data = np.array(column(first, ":blob")[0], np.uint8)
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert decoded is not None
    shown = cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB)
    assert np.abs(shown.astype(int) - frames[0].image).mean() < 6


def test_boxes_bear_the_identities(rows, run):
    _, result = run
    for row in rows["/camera/boxes"]:
        tracks = result.tracks[row["frame"]]
        names = [tracks.display_name(number) for number in range(len(tracks))]
        assert column(row, ":labels") == names
        assert column(row, ":class_ids") == [i + 2 if i >= 0 else 1 for i in tracks.object_id]
        half = np.array(column(row, ":half_sizes"))
        expected = (tracks.boxes[:, 2:] - tracks.boxes[:, :2]) / 2
        np.testing.assert_allclose(half, expected, atol=1e-4)  # stored in float32


def test_masks_have_the_classes_of_the_boxes(rows, run):
    _, result = run
    for row in rows["/camera/masks"][:5]:
        tracks = result.tracks[row["frame"]]
        buffer = column(row, ":buffer")[0]
        numbers = np.array(buffer, np.uint8).view(np.uint16).reshape(tracks.frame_size)
        assert set(np.unique(numbers)) - {0} <= {i + 2 if i >= 0 else 1 for i in tracks.object_id}
        np.testing.assert_array_equal(numbers > 0, tracks.masks.any(axis=0))


def test_memory_is_a_tree_of_objects(rows):
    assert {"/memory/book/2", "/memory/teddy\\ bear/4", "/memory/cup/0/confidence"} <= set(rows)
    assert column(rows["/memory/book/2"][0], ":text") == ["book 2"]
    assert [column(row, ":scalars") for row in rows["/memory/objects"]][-1] == [6.0]


def test_returns_are_events(rows):
    texts = [column(row, ":text")[0] for row in rows["/events"]]
    assert "cup 0 is met first" in texts
    assert any("is seen again after" in text for text in texts)


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(OutputError, match=r"missing/out.rrd cannot be opened"):
        RerunRecord(tmp_path / "missing" / "out.rrd", "run")


def test_frames_without_image_keep_their_detections(run, tmp_path):
    frames, result = run
    with RerunRecord(tmp_path / "out.rrd", "run") as record:
        record.add(dataclasses.replace(frames[0], image=None), result.tracks[0])
    entities = {
        str(c.entity_path) for c in chunk.RrdReader(tmp_path / "out.rrd").stream().to_chunks()
    }
    assert "/camera/boxes" in entities
    assert "/camera/image" not in entities
