"""The same two scenes give the same scores in every format and in every mixture of formats."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from remind_jax.errors import RemindError, SourceError
from remind_jax.metrics import SceneOptions, evaluate
from remind_jax.metrics.opening import open_scenes
from tests.formats import scenes as made
from tests.formats.scenes import ANSWERS, TRUTH

Writer = Callable[[Path, dict[str, list[str]]], Path]


def _texts(spell: Callable[[list[str]], str]) -> Writer:
    return lambda root, scenes: made.write_texts(root, {n: spell(r) for n, r in scenes.items()})


def _json(spell: Callable[[Any], Any]) -> Writer:
    return lambda root, scenes: made.write_json(root.with_suffix(".json"), spell(scenes))


WRITERS: dict[str, tuple[str, Writer]] = {
    "mot": ("mot", _texts(made.mot_text)),
    "mots": ("mots", _texts(made.mots_text)),
    "kitti-mots": ("kitti-mots", _texts(lambda rows: made.mots_text(rows, 0))),
    "maps": ("davis", made.write_maps),
    "davis": ("davis", made.write_davis),
    "coco masks": ("coco-video", _json(made.coco_video)),
    "coco boxes": ("coco-video", _json(lambda scenes: made.coco_video(scenes, "bboxes"))),
}

# Object 1 shrinks to half of its mask in the last frame (an overlap of 0.5 counts as a match);
# object 2 returns under another id.
EXPECTED = {"IDTP": 9, "IDFN": 1, "IDFP": 1, "IDSW": 1, "GT_IDs": 3, "Opportunities": 1}


@pytest.mark.parametrize("prediction", WRITERS)
@pytest.mark.parametrize("truth", ["mot", "mots", "davis", "coco masks"])
def test_every_mixture_scores_alike(tmp_path: Path, truth: str, prediction: str):
    truth_path = WRITERS[truth][1](tmp_path / "truth", TRUTH)
    made_of = {k: v for k, v in ANSWERS.items()}
    prediction_path = WRITERS[prediction][1](tmp_path / "prediction", made_of)
    if prediction == "davis":
        (prediction_path / "metadata.json").unlink()
    formats: dict[str, Any] = {}
    if (truth, prediction) == ("mots", "kitti-mots"):  # taken for one numbering unless told
        formats = {"truth_format": "mots", "format": "kitti-mots"}
    evaluation = evaluate(truth_path, prediction_path, **formats)
    scores = evaluation.scores()
    assert {name: int(scores[name]) for name in EXPECTED} == EXPECTED
    assert (scores["Recovery"], scores["Scenes"], scores["FailedScenes"]) == (0.0, 2, 0)
    assert not evaluation.failed


@pytest.mark.parametrize("name", WRITERS)
def test_formats_are_recognized(tmp_path: Path, name: str):
    format, write = WRITERS[name]
    opened = open_scenes(write(tmp_path / "x", TRUTH))
    assert opened.format == format
    rows = next(iter(opened.read.values()))()
    assert rows.num_frames == 4
    assert rows.track_id.tolist() == [1, 2, 1, 2, 1, 1, 2]
    assert rows.boxes[1].tolist() == [3, 0, 5, 4]


def test_truth_beside_detections_that_are_input_is_no_run(tmp_path: Path):
    truth = made.write_davis(tmp_path / "truth", TRUTH)
    (truth / "detections.jsonl").write_text('{"frame": 0, "detections": []}\n')
    assert open_scenes(truth).format == "davis"
    (truth / "detections.jsonl").write_text("damaged\n")
    assert open_scenes(truth).format == "run"


def test_result_lists_lean_on_the_truth(tmp_path: Path):
    truth = made.write_json(tmp_path / "truth.json", made.coco_video(TRUTH))
    results = made.write_json(tmp_path / "results.json", made.coco_results(ANSWERS))
    assert evaluate(truth, results).scores()["IDTP"] == 9
    empty = made.write_json(tmp_path / "empty.json", [])
    assert evaluate(truth, empty).scores()["IDFN"] == 10
    davis = made.write_davis(tmp_path / "davis", TRUTH)
    with pytest.raises(SourceError, match="list of results"):
        evaluate(davis, results)


def test_one_scene_matches_one_scene_whatever_their_names(tmp_path: Path):
    truth = made.write_maps(tmp_path / "truth", {"one": TRUTH["one"]})
    (tmp_path / "out.txt").write_text(made.mot_text(ANSWERS["one"]))
    evaluation = evaluate(truth / "one", tmp_path / "out.txt")
    assert evaluation.name == "out"
    assert evaluation.scores()["IDTP"] == 6


def test_breakdowns_come_from_the_truth(tmp_path: Path):
    truth = made.write_davis(tmp_path / "truth", TRUTH)
    prediction = made.write_maps(tmp_path / "prediction", ANSWERS)
    breakdowns = evaluate(truth, prediction).pooled.breakdowns
    assert set(breakdowns) == {"visible", "size", "distractors", "class"}
    by_class = breakdowns["class"]
    counts = dict(zip(by_class.bins, by_class.observations.tolist(), strict=True))
    assert counts == {"cup": 7, "box": 3}
    assert dict(zip(by_class.bins, by_class.right.tolist(), strict=True)) == {"cup": 6, "box": 3}
    assert breakdowns["distractors"].observations.tolist() == [4, 6, 0, 0, 0, 0, 0]
    assert breakdowns["size"].observations.sum() == 10


def test_every_class_apart(tmp_path: Path):
    truth = made.write_davis(tmp_path / "truth", TRUTH)
    prediction = made.write_json(tmp_path / "p.json", made.coco_video(TRUTH))
    content = evaluate(truth, prediction, options=SceneOptions(by_class=True)).to_json()
    assert {c: scores["GT_Dets"] for c, scores in content["classes"].items()} == {
        "cup": 7,
        "box": 3,
    }


def test_void_is_not_evaluated(tmp_path: Path):
    root = made.write_maps(tmp_path / "truth", {"one": ["11...."]})
    labels = made.label_maps(["11...."])[0].astype(np.uint8)
    labels[:, 3:] = 255
    cv2.imwrite(str(root / "one" / "00000.png"), labels)
    prediction = made.write_maps(tmp_path / "prediction", {"one": ["77.88."]})
    scores = evaluate(root, prediction).scores()
    assert (scores["GT_Dets"], scores["Dets"], scores["CLR_FP"]) == (1, 1, 0)


def test_masks_of_another_scale_are_fitted(tmp_path: Path):
    truth = made.write_maps(tmp_path / "truth", {"one": TRUTH["one"]})
    folder = tmp_path / "large" / "one"
    folder.mkdir(parents=True)
    for frame, labels in enumerate(made.label_maps(TRUTH["one"])):
        large = np.kron(labels, np.ones((3, 3), int)).astype(np.uint8)
        cv2.imwrite(str(folder / f"{frame:05d}.png"), large)
    assert evaluate(truth, tmp_path / "large").scores()["LocA"] == 1.0
    for frame in range(4):
        cv2.imwrite(str(folder / f"{frame:05d}.png"), np.ones((30, 6), np.uint8))
    with pytest.raises(SourceError, match="aspect ratios differ"):
        evaluate(truth, tmp_path / "large")


def test_failed_scenes_are_counted(tmp_path: Path):
    truth = made.write_maps(tmp_path / "truth", TRUTH)
    prediction = made.write_texts(
        tmp_path / "prediction", {"one": made.mot_text(ANSWERS["one"]), "two": "1,1,0,0,x,1\n"}
    )
    evaluation = evaluate(truth, prediction, format="mot")
    assert list(evaluation.failed) == ["two"]
    assert "two.txt" in evaluation.failed["two"]
    assert (evaluation.scores()["Scenes"], evaluation.scores()["FailedScenes"]) == (2, 1)
    (prediction / "two.txt").unlink()
    (prediction / "three.txt").write_text(made.mot_text(ANSWERS["two"]))
    evaluation = evaluate(truth, prediction)
    assert evaluation.failed == {"two": "there is no prediction of this scene"}
    assert evaluation.notes == ("1 predicted scenes are not in the truth: three",)
    assert json.loads(json.dumps(evaluation.to_json()))["failed"] == evaluation.failed
    (prediction / "one.txt").write_text("nothing")
    with pytest.raises(SourceError, match="none of 2 scenes could be scored; 'one'"):
        evaluate(truth, prediction, format="mot")


def test_other_json_is_refused(tmp_path: Path):
    federated = made.coco_video(TRUTH)
    federated["videos"][0]["neg_category_ids"] = [1]
    for content in (
        {"a": 1},
        [{"image_id": 1}],
        3,
        {"annotations": [{"segmentations": []}], "videos": [{"name": "a"}]},
        {"videos": [{"id": 1, "length": 10**9}]},
        {"videos": [{"id": 1, "name": "x" * 20_000}]},
        federated,
    ):
        path = made.write_json(tmp_path / "x.json", content)
        with pytest.raises(SourceError, match=r"x\.json"):
            open_scenes(path)


def test_bad_annotations_are_refused(tmp_path: Path):
    for change in (
        {"segmentations": [{"size": [4, 6]}]},
        {"segmentations": [{"size": [4, 10**6], "counts": ""}]},
        {"segmentations": [{"size": [4, 6], "counts": "\u00e9"}]},
        {"segmentations": [[[1e9, 1, 2, 2, 3, 3]]]},
        {"bboxes": [[1, 2, 3]], "segmentations": None},
        {"bboxes": [[1, 2, 3, 1e300]], "segmentations": None},
        {"segmentations": [{"size": [4, 6], "counts": "zz"}]},
        {"segmentations": [{"size": [4, 6], "counts": [3, 4]}]},
        {"segmentations": [[[1, 1, 2]]]},
        {"segmentations": [None] * 5},
        {"segmentations": None},
        {"id": "x"},
    ):
        content = made.coco_video({"one": TRUTH["one"]})
        content["annotations"][1] |= change
        path = made.write_json(tmp_path / "x.json", content)
        with pytest.raises(SourceError, match=r"x\.json.*row 2"):
            open_scenes(path).read["one"]()


@pytest.mark.parametrize("name", ["pipe", "pipe.json", "pipe.xml", "pipe.zip", "pipe.txt"])
def test_a_pipe_is_not_waited_for(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / name)
    with pytest.raises(SourceError, match="it is a pipe, a device or a socket"):
        open_scenes(tmp_path / name)


def test_bad_places_are_refused(tmp_path: Path):
    with pytest.raises(SourceError, match="No such file"):
        open_scenes(tmp_path / "absent")
    with pytest.raises(SourceError, match="holds no tracks in a known format"):
        open_scenes(tmp_path)
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(SourceError, match="truncated"):
        open_scenes(tmp_path / "broken.json")
    undecided: Any = "later"
    with pytest.raises(RemindError, match="undecided is 'later'; allowed: collapse, strict"):
        evaluate(tmp_path, tmp_path, options=SceneOptions(undecided=undecided))
