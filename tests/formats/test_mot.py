"""Text as TrackEval reads it."""

from pathlib import Path

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.formats.mot import FileFormat, fit_texts, read_text_rows, recognize_format
from remind_jax.formats.rows import TrackRows
from remind_jax.masks.run_length import encode_masks
from remind_jax.metrics.scene_evaluation import SceneOptions, evaluate
from tests.metrics.golden import load_texts


def write(path: Path, *lines: str) -> Path:
    path.write_text("".join(line + "\n" for line in lines))
    return path


def read(path: Path, format: FileFormat = "mot", *, is_truth: bool = False) -> TrackRows:
    return read_text_rows(path, path.stem, format, is_truth=is_truth)


def mots_line(frame: int, track: int, class_id: int, columns: slice) -> str:
    mask = np.zeros((4, 10), bool)
    mask[:, columns] = True
    return f"{frame} {track} {class_id} 4 10 {encode_masks(mask[None])[0]['counts'].decode()}"


def test_rows_of_boxes(tmp_path: Path):
    path = write(tmp_path / "gt.txt", "2,5,1.5,-2,10,20,1,1,0.5", "1,4,0,0,2,2,0,7,1")
    rows = read(path)
    assert rows.frame.tolist() == [0, 1]
    assert rows.boxes.tolist() == [[0, 0, 2, 2], [1.5, -2, 11.5, 18]]
    assert rows.text_class.tolist() == [7, 1]
    assert read(path, is_truth=True).text_class.tolist() == [1]


def test_other_spellings_of_a_row(tmp_path: Path):
    path = tmp_path / "pred.txt"
    spellings = ["1 4 0 0 2 2\n", "1,4,0,0,2,2", "1, 4, 0, 0, 2, 2\r\n", "1,4,0,0,2,2e0\n\n"]
    for text in (*spellings, "\ufeff1,4,0,0,2,2"):
        path.write_text(text)
        rows = read(path)
        assert rows.boxes.tolist() == [[0, 0, 2, 2]]
        assert rows.text_class.tolist() == [-1]


def test_flagged_rows_and_other_classes_are_left_out(tmp_path: Path):
    gt = write(
        tmp_path / "gt.txt",
        "1,1,0,0,10,10,1,1,1",
        "1,2,20,0,10,10,0,8,1",  # a reflection
        "1,3,40,0,10,10,1,3,1",  # a car
    )
    pred = write(tmp_path / "pred.txt", *(f"1,{i},{20 * i},0,10,10,1,-1,-1,-1" for i in range(3)))
    plain = load_texts(gt, pred, "mot")
    assert (plain.gt.id.tolist(), plain.pred.id.tolist()) == ([1, 3], [0, 1, 2])
    assert load_texts(gt, pred, "mot", class_id=1).gt.id.tolist() == [1]


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
    sequence = load_texts(gt, pred, "mots")
    assert sequence.gt.id.tolist() == [2001]
    assert sequence.pred.id.tolist() == [1, 3]
    assert sequence.class_names == ("pedestrian",)
    cars = load_texts(gt, gt, "mots", class_id=1)
    assert cars.pair_similarity.tolist() == [1.0]


def test_formats_are_recognized(tmp_path: Path):
    empty = write(tmp_path / "empty.txt")
    mot = write(tmp_path / "mot.txt", "1,1,0,0,1,1")
    mots = write(tmp_path / "mots.txt", mots_line(1, 1, 2, slice(0, 1)))
    kitti = write(tmp_path / "kitti.txt", mots_line(0, 1, 2, slice(0, 1)))
    assert recognize_format(mot, empty) == "mot"
    assert recognize_format(empty, mots) == "mots"
    assert recognize_format(kitti, mots) == recognize_format(mots, kitti) == "kitti-mots"
    assert recognize_format(empty, empty) == "mot"
    with pytest.raises(SourceError, match="neither MOTChallenge text"):
        recognize_format(write(tmp_path / "x.txt", "hello"))


def test_bad_rows_are_refused(tmp_path: Path):
    bad: dict[str, list[list[str]]] = {
        "mot": [
            *(["1,1,0,0,1"], ["1,1,0,0,1,x"], ["1,1,0,0,1,nan"], ["1,1,0,0,1,1,1,1,-inf"]),
            *(["0,1,0,0,1,1"], ["9,1,0,0,1,1"], ["99999999999,1,0,0,1,1"], ["1.5,1,0,0,1,1"]),
            *(["1,2,0,0,1,1", "1,0.5,0,0,1,1"], ["1,1,0,0,-5,1"]),
        ],
        "mots": [
            *(["1 1 2 4 10 zz"], ["1 1 2 4"], ["1 1 2 0 10 zz"]),
            *([f"1 {10**40} 2 4 10 zz"], [f"1 1 2 4 {10**40} zz"]),
            [mots_line(1, 1, 2, slice(0, 3)), mots_line(1, 2, 2, slice(2, 4))],
        ],
    }
    good = {"mot": "1,1,0,0,1,1", "mots": mots_line(1, 1, 2, slice(0, 1))}
    for format, cases in bad.items():
        truth = write(tmp_path / "gt.txt", good[format])
        for lines in cases:
            pred = write(tmp_path / "pred.txt", *lines)
            with pytest.raises(SourceError, match=r"pred\.txt"):
                load_texts(truth, pred, format, num_frames=3)  # pyright: ignore
    twice = write(tmp_path / "pred.txt", "1,1,0,0,1,1", "1,1,5,5,1,1")
    with pytest.raises(SourceError, match="frame 1: prediction id 1 occurs 2 times"):
        load_texts(write(tmp_path / "gt.txt", good["mot"]), twice, "mot")


def test_what_is_not_scored_is_said(tmp_path: Path):
    lines = [mots_line(1, number, 3 - number, slice(number, number + 1)) for number in (1, 2)]
    truth = write(tmp_path / "truth.txt", *lines)
    options = SceneOptions(by_class=True)
    notes = evaluate(truth, truth, truth_format="mots", format="mots", options=options).notes
    for said in ("class 2 is scored, without 1 true row of", "no class is scored apart"):
        assert sum(said in note for note in notes) == 1


def test_a_class_that_nothing_has_is_refused(tmp_path: Path):
    masks = write(tmp_path / "masks.txt", mots_line(1, 1, 5, slice(0, 3)))
    with pytest.raises(SourceError, match="no row of class 7"):
        load_texts(masks, masks, "mots", class_id=7)
    people = write(tmp_path / "people.txt", mots_line(1, 1, 2, slice(0, 3)))
    for sides in ((masks, people), (people, masks)):
        with pytest.raises(SourceError, match=r"masks\.txt has no row of class 2; it has 5"):
            load_texts(*sides, "mots")
    boxes = write(tmp_path / "boxes.txt", "1,1,1,1,5,5,1,3,1")
    rows = read_text_rows(boxes, "a", "mot", is_truth=True)
    assert len(fit_texts(rows, rows, class_id=3)[0]) == 1
    with pytest.raises(SourceError, match="has no row of class 99; it has 3"):
        fit_texts(rows, rows, class_id=99)
    plain = read_text_rows(write(tmp_path / "plain.txt", "1,1,1,1,5,5"), "a", "mot", is_truth=True)
    with pytest.raises(SourceError, match="it has none that says its class"):
        fit_texts(plain, plain, class_id=3)
