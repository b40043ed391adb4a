"""What a live run saw, kept without loss and read back as a source."""

import json

import numpy as np
import pytest

import remind_jax as rj
from remind_jax.errors import OutputError
from remind_jax.frame import Detections, Frame
from remind_jax.outputs.frame_record import FrameRecord
from tests.sources.making import assert_same_detections


def make_frames(num: int = 5, size: tuple[int, int] = (37, 51)) -> list[Frame]:
    """Noise, which no codec with loss keeps; odd sides; none, one or two detections."""
    rng = np.random.default_rng(0)
    frames = []
    for index in range(num):
        image = rng.integers(0, 255, (*size, 3), np.uint8)
        seen = Detections.create(
            rng.random((index % 3, *size)) > 0.5,
            ["mug", "bowl"][: index % 3],
            scores=rng.random(index % 3),
            instance_ids=np.arange(index % 3) + 7,
        )
        frames.append(Frame(index, 3 * index, 0.1 * index + 0.0304, str(index), image, seen))
    return frames


def test_frames_and_detections_come_back_bit_by_bit(tmp_path):
    frames = make_frames()
    with FrameRecord(tmp_path / "seen") as record:
        for frame in frames:
            record.add(frame)
    again = list(rj.open_source(tmp_path / "seen", masks=tmp_path / "seen" / "detections.jsonl"))
    assert len(again) == len(frames)
    for seen, back in zip(frames, again, strict=True):
        np.testing.assert_array_equal(seen.image, back.image)
        assert_same_detections(seen.detections, back.detections)


def test_every_frame_is_on_disk_at_once(tmp_path):
    with FrameRecord(tmp_path / "seen") as record:
        record.add(make_frames()[2])
        rows = (tmp_path / "seen" / "detections.jsonl").read_text().splitlines()
        assert (tmp_path / "seen" / "000000.png").is_file()
    (row,) = map(json.loads, rows)
    assert (row["frame"], row["source_index"], len(row["detections"])) == (0, 6, 2)


def test_what_is_there_is_kept_unless_told(tmp_path):
    frames = make_frames()
    for count in (4, 2):
        with FrameRecord(tmp_path / "seen", overwrite=True) as record:
            for frame in frames[:count]:
                record.add(frame)
    assert len(list(rj.open_source(tmp_path / "seen"))) == 2
    with pytest.raises(OutputError, match="is there already; choose another name for the record"):
        FrameRecord(tmp_path / "seen")
    with pytest.raises(OutputError, match=r"as '\.mp4'; give a folder"):
        FrameRecord(tmp_path / "seen.mp4")


def test_a_frame_without_image_cannot_be_recorded(tmp_path):
    frame = Frame(0, 0, 0.0, "first", None, Detections.empty(4, 4))
    with (
        FrameRecord(tmp_path / "seen") as record,
        pytest.raises(OutputError, match="frame 'first' has no image to record"),
    ):
        record.add(frame)


def test_a_record_of_nothing_is_in_nobodys_way(tmp_path):
    for _ in range(2):
        with FrameRecord(tmp_path / "seen"):
            pass
    assert not list((tmp_path / "seen").iterdir())
