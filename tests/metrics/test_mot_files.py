from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.errors import SourceError
from remind_jax.masks.run_length import encode_masks
from remind_jax.metrics.decimal_text import parse_decimal_table
from remind_jax.metrics.mot_files import read_mot_rows, read_mots_rows, recognise_format
from remind_jax.metrics.text_sequences import (
    MOT17_DISTRACTORS,
    load_mot_sequence,
    load_mots_sequence,
)


def write(path: Path, *lines: str) -> Path:
    path.write_text("".join(line + "\n" for line in lines))
    return path


def mots_line(frame: int, track: int, class_id: int, columns: slice) -> str:
    mask = np.zeros((4, 10), bool)
    mask[:, columns] = True
    return f"{frame} {track} {class_id} 4 10 {encode_masks(mask[None])[0]['counts'].decode()}"


def test_rows_of_boxes(tmp_path: Path):
    path = write(tmp_path / "gt.txt", "2,5,1.5,-2,10,20,1,1,0.5", "1,4,0,0,2,2,0,7,1")
    rows = read_mot_rows(path)
    assert rows.frame.tolist() == [1, 2]
    assert rows.boxes.tolist() == [[0, 0, 2, 2], [1.5, -2, 11.5, 18]]
    assert (rows.flag.tolist(), rows.class_id.tolist()) == ([0, 1], [7, 1])


@pytest.mark.parametrize(
    "text",
    [
        "1 4 0 0 2 2\n",
        "1,4,0,0,2,2",
        "1, 4, 0, 0, 2, 2\r\n",
        "1,4,0,0,2,2e0\n\n",
        "\ufeff1,4,0,0,2,2",
    ],
)
def test_other_spellings_of_a_row(tmp_path: Path, text: str):
    path = tmp_path / "pred.txt"
    path.write_text(text)
    rows = read_mot_rows(path)
    assert rows.boxes.tolist() == [[0, 0, 2, 2]]
    assert rows.class_id.tolist() == [-1]


@settings(deadline=None)
@given(
    st.lists(
        st.lists(
            st.decimals(-(10**6), 10**6, allow_nan=False, places=5).map("{:f}".format)
            | st.integers(-(10**14), 10**14).map(str)
            | st.sampled_from(["0", "-0.0", "1.", ".5", "-.25", "007"]),
            min_size=3,
            max_size=3,
        ),
        min_size=1,
    )
)
def test_decimals_are_read_as_python_reads_them(cells: list[list[str]]):
    text = "\n".join(",".join(row) for row in cells).encode()
    table = parse_decimal_table(text)
    assert table is not None
    assert table.tolist() == [[float(cell) for cell in row] for row in cells]


@pytest.mark.parametrize(
    "text",
    [
        "1,2\n3",
        "1,,2",
        "1 2",
        "1e3,2",
        "1,2\n\n3,4",
        "1.2.3,4",
        "1-2,3",
        "-,3",
        "1,nan",
        "",
        "1234567890123456,1",
    ],
)
def test_anything_but_plain_decimals_is_left_to_others(text: str):
    assert parse_decimal_table(text.encode()) is None


def test_flagged_rows_and_other_classes_are_left_out(tmp_path: Path):
    gt = write(
        tmp_path / "gt.txt",
        "1,1,0,0,10,10,1,1,1",
        "1,2,20,0,10,10,0,8,1",  # a reflection
        "1,3,40,0,10,10,0,3,1",  # a car
    )
    pred = write(tmp_path / "pred.txt", *(f"1,{i},{20 * i},0,10,10,1,-1,-1,-1" for i in range(3)))
    plain = load_mot_sequence(gt, pred)
    assert (plain.gt_id.tolist(), plain.pred_id.tolist()) == ([1], [0, 1, 2])
    cleaned = load_mot_sequence(gt, pred, class_id=1, distractors=MOT17_DISTRACTORS)
    assert (cleaned.gt_id.tolist(), cleaned.pred_id.tolist()) == ([1], [0, 2])


def test_masks_in_ignored_regions_are_left_out(tmp_path: Path):
    gt = write(
        tmp_path / "gt.txt",
        mots_line(1, 2001, 2, slice(0, 2)),
        mots_line(1, 1001, 1, slice(2, 4)),
        mots_line(1, 10000, 10, slice(4, 7)),
    )
    pred = write(
        tmp_path / "pred.txt",
        mots_line(1, 1, 2, slice(0, 2)),
        mots_line(1, 2, 2, slice(4, 6)),  # inside
        mots_line(1, 3, 2, slice(6, 8)),  # half inside
    )
    sequence = load_mots_sequence(gt, pred)
    assert sequence.gt_id.tolist() == [2001]
    assert sequence.pred_id.tolist() == [1, 3]
    assert sequence.class_names == ("pedestrian",)
    cars = load_mots_sequence(gt, gt, class_id=1)
    assert cars.pair_similarity.tolist() == [1.0]


def test_formats_are_recognised(tmp_path: Path):
    empty = write(tmp_path / "empty.txt")
    mot = write(tmp_path / "mot.txt", "1,1,0,0,1,1")
    mots = write(tmp_path / "mots.txt", mots_line(1, 1, 2, slice(0, 1)))
    kitti = write(tmp_path / "kitti.txt", mots_line(0, 1, 2, slice(0, 1)))
    assert recognise_format(mot, empty) == "mot"
    assert recognise_format(empty, mots) == "mots"
    assert recognise_format(kitti, mots) == "kitti-mots"
    assert recognise_format(empty, empty) == "mot"
    with pytest.raises(SourceError, match="neither MOTChallenge text"):
        recognise_format(write(tmp_path / "x.txt", "hello"))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["1,1,0,0,1"], "rows of 5 columns"),
        (["1,1,0,0,1,x"], "is not MOTChallenge text"),
        (["1,1,0,0,1,nan"], "finite numbers"),
        (["0,1,0,0,1,1"], "has a row of frame 0; frames are numbered 1 to"),
        (["9,1,0,0,1,1"], "has a row of frame 9; frames are numbered 1 to 3"),
        (["1,1,0,0,1,1", "1,1,5,5,1,1"], "frame 1: prediction id 1 occurs 2 times"),
        (["99999999999,1,0,0,1,1"], "row of frame 99999999999; frames are numbered up to"),
        (["1.5,1,0,0,1,1"], r"row 1: frame is 1.5; it must be a whole number"),
        (["1,2,0,0,1,1", "1,0.5,0,0,1,1"], r"row 2: id is 0.5; it must be a whole number"),
    ],
)
def test_bad_boxes_are_refused(tmp_path: Path, lines: list[str], message: str):
    good = write(tmp_path / "gt.txt", "1,1,0,0,1,1")
    with pytest.raises(SourceError, match=message):
        load_mot_sequence(good, write(tmp_path / "pred.txt", *lines), num_frames=3)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["1 1 2 4 10 zz"], "frame 1, id 1: the run lengths are damaged or do not add up"),
        (["1 1 2 4"], r"line 1: '1 1 2 4' is not a MOTS row"),
        ([mots_line(1, 1, 2, slice(0, 3)), mots_line(1, 2, 2, slice(2, 4))], "masks overlap"),
        ([mots_line(1, 1, 5, slice(0, 3))], "no row of class 7; they have 2, 5"),
    ],
)
def test_bad_masks_are_refused(tmp_path: Path, lines: list[str], message: str):
    good = write(tmp_path / "gt.txt", mots_line(1, 1, 2, slice(0, 1)))
    pred = write(tmp_path / "pred.txt", *lines)
    with pytest.raises(SourceError, match=message):
        load_mots_sequence(good, pred, class_id=7 if "class 7" in message else 2)


def test_files_that_cannot_be_read(tmp_path: Path):
    with pytest.raises(SourceError, match="cannot be read: No such file"):
        read_mot_rows(tmp_path / "absent.txt")
    (tmp_path / "video.mp4").write_bytes(bytes(range(256)))
    with pytest.raises(SourceError, match="is not a text file"):
        read_mots_rows(tmp_path / "video.mp4")
