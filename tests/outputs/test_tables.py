import csv
import dataclasses

import numpy as np
import pytest
from hotcoco import mask as coco_mask

from remind_jax.decision import Outcome
from remind_jax.formats.coco_tracks import coco_video
from remind_jax.formats.cvat import to_cvat
from remind_jax.formats.firm import firm_rows
from remind_jax.formats.mot import mot_lines, mots_lines
from remind_jax.outputs import tables
from tests.outputs.fake_run import make_run, make_tracks


def squares(*corners: tuple[int, int]) -> np.ndarray:
    masks = np.zeros((len(corners), 16, 20), bool)
    for mask, (x, y) in zip(masks, corners, strict=True):
        mask[y : y + 4, x : x + 4] = True
    return masks


def test_csv_has_every_detection(tmp_path):
    _, result = make_run(num_frames=30)
    path, label = tmp_path / "tracks.csv", 'cup, "big"\nblue'
    awkward = make_tracks(30, squares((1, 1)), [{"object_id": 0, "label": label}])
    with tables.csv_writer(path) as writer:
        for tracks in (*result.tracks, awkward):
            writer.add(tracks)
    with path.open(newline="") as file:
        *rows, last = csv.DictReader(file)
    assert last["label"] == label
    assert len(rows) == sum(len(tracks) for tracks in result.tracks)
    undecided = next(row for row in rows if row["outcome"] == "ambiguous")
    assert undecided["candidates"] == "1:0.82;0:0.79"
    assert undecided["object_id"] == "-1"
    assert undecided["reason"] == "known_but_ambiguous"
    assert tuple(rows[0]) == tables.CSV_COLUMNS


def test_mot_counts_from_one_and_leaves_out_undecided():
    rows = [
        {"object_id": 0, "confidence": 0.75},
        {"object_id": -1, "outcome": Outcome.AMBIGUOUS, "candidates": [(0, 0.8), (1, 0.7)]},
        {"object_id": 1, "outcome": Outcome.NEW, "score": 0.0, "confidence": 0.0},
    ]
    tracks = make_tracks(0, squares((2, 3), (9, 9), (5, 5)), rows)
    assert mot_lines([tracks]) == [
        "1,1,2.00,3.00,4.00,4.00,0.7500,-1,-1,-1",
        "1,2,5.00,5.00,4.00,4.00,1.0000,-1,-1,-1",  # not rated by the paper's tracker
    ]
    strided = dataclasses.replace(tracks, source_index=6)
    assert [line.split(",")[0] for line in mot_lines([strided])] == ["7", "7"]


def test_an_identity_given_twice_stays_with_the_better_supported():
    rows = [
        {"object_id": 5, "score": 0.7},
        {"object_id": 5, "score": 0.8},
        {"object_id": 2, "score": 0.1},
        {"object_id": 5, "score": 0.8},
    ]
    tracks = make_tracks(0, squares((0, 0), (5, 0), (10, 0), (15, 0)), rows)
    assert firm_rows(tracks).tolist() == [1, 2]


def test_mots_masks_do_not_overlap():
    masks = squares((2, 2), (4, 4), (12, 8))
    rows = [
        {"object_id": 0, "confidence": 0.6},
        {"object_id": 1, "confidence": 0.9, "label": "car"},
        {"object_id": 2, "confidence": 0.5},
    ]
    lines = [line.split() for line in mots_lines([make_tracks(0, masks, rows)])]
    assert [line[:5] for line in lines] == [
        ["1", "1", "2", "16", "20"],
        ["1", "2", "1", "16", "20"],
        ["1", "3", "2", "16", "20"],
    ]
    read = np.array([coco_mask.decode({"size": [16, 20], "counts": line[5]}) for line in lines])
    assert read.sum(0).max() == 1
    np.testing.assert_array_equal(read[0], masks[0] & ~masks[1])
    np.testing.assert_array_equal(read[1:], masks[1:])


def test_an_identity_has_one_class():
    masks = squares((2, 2))
    frames = [
        make_tracks(number, masks, [{"object_id": 0, "label": label}])
        for number, label in enumerate(("truck", "car", "car"))
    ]
    assert {line.split()[2] for line in mots_lines(frames)} == {"1"}
    (annotation,) = coco_video(frames, ["car", "truck"], "tour", 10.0)["annotations"]
    assert annotation["category_id"] == 1
    assert b'<track id="0" label="car"' in to_cvat(frames, "tour", ["car", "truck"], (4, 4))


def test_mots_leaves_out_a_mask_hidden_by_others():
    masks = squares((2, 2), (2, 2))
    rows = [{"object_id": 0, "confidence": 0.9}, {"object_id": 1, "confidence": 0.5}]
    lines = mots_lines([make_tracks(0, masks, rows)])
    assert [line.split()[1] for line in lines] == ["1"]


def test_coco_video_has_one_entry_per_frame():
    _, result = make_run(num_frames=30)
    content = coco_video(result.tracks, result.class_names, "tour", 10.0)
    (video,) = content["videos"]
    assert video["length"] == len(video["file_names"]) == 30
    assert [annotation["id"] for annotation in content["annotations"]] == [1, 2, 3, 4, 5, 6]
    names = {category["id"]: category["name"] for category in content["categories"]}
    for annotation in content["annotations"]:
        object_id = annotation["id"] - 1
        for tracks, rle, box, area in zip(
            result.tracks,
            annotation["segmentations"],
            annotation["bboxes"],
            annotation["areas"],
            strict=True,
        ):
            rows = np.flatnonzero(tracks.object_id == object_id)
            assert (rle is None) == (len(rows) == 0) == (box is None) == (area is None)
            if rle is not None:
                assert tracks.labels[rows[0]] == names[annotation["category_id"]]
                mask = coco_mask.decode(rle)
                np.testing.assert_array_equal(mask, tracks.masks[rows[0]])
                assert area == mask.sum()
                assert box == coco_mask.toBbox(rle).tolist()


@pytest.mark.parametrize("num_frames", [0, 1])
def test_runs_without_identities_have_tables(tmp_path, num_frames):
    tracks = [make_tracks(i, np.zeros((0, 8, 8), bool), []) for i in range(num_frames)]
    tables.write_tables(tmp_path, tracks, ("cup",), "empty", 10.0)
    assert (tmp_path / "mot.txt").read_text() == ""
    assert (tmp_path / "mots.txt").read_text() == ""
