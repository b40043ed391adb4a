"""Federated truth (TAO, BURST): numbers equal TrackEval's, and each rule by hand."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from remind_jax.metrics import SetEvaluation, evaluate, evaluate_sequence
from remind_jax.metrics.federated import evaluate_federated, name_categories
from remind_jax.metrics.formats.opening import SceneSet, open_scenes
from remind_jax.metrics.formats.rows import TrackRows
from remind_jax.metrics.pairing import pair_scene
from tests.metrics.golden import ROOT, TOLERANCE, read_json

FOLDER = ROOT / "federated"
CASES = sorted(path.name for path in FOLDER.iterdir())


def score(folder: Path) -> dict[str, Any]:
    return evaluate(folder / "gt.json", folder / "pred.json").to_json()["federated"]


def score_boxes(folder: Path) -> dict[str, Any]:
    """With the boxes of masks, cut to whole pixels."""

    def read(scenes: SceneSet, name: str) -> TrackRows:
        rows = scenes.read[name]()
        sides = np.trunc(np.hstack([rows.boxes[:, :2], rows.boxes[:, 2:] - rows.boxes[:, :2]]))
        sides[:, 2:] += sides[:, :2]
        return dataclasses.replace(rows, boxes=sides, rles=None)

    truth = open_scenes(folder / "gt.json")
    predictions = open_scenes(folder / "pred.json", truth=truth)
    evaluations = []
    for name in truth.names:
        paired = pair_scene(read(truth, name), read(predictions, name))
        named, federation = name_categories(paired), paired.truth.federation
        assert named is not None
        assert federation is not None
        scores = evaluate_federated(named, federation)
        evaluations.append(
            dataclasses.replace(evaluate_sequence(paired.sequence), federated=scores)
        )
    return SetEvaluation("boxes", tuple(evaluations)).to_json()["federated"]


@pytest.mark.parametrize("name", CASES)
def test_scores_equal_trackeval(name: str):
    assert_equal(score(FOLDER / name), read_json(FOLDER / name / "expected.json"))


@pytest.mark.parametrize("name", [name for name in CASES if name.startswith("burst")])
def test_boxes_of_burst_masks_equal_trackeval(name: str):
    assert_equal(score_boxes(FOLDER / name), read_json(FOLDER / name / "expected_boxes.json"))


def assert_equal(got: dict[str, Any], expected: dict[str, Any]) -> None:
    """All fields of all classes, and no others."""
    assert set(got["classes"]) == set(expected["classes"])
    tables = [("class_averaged",), ("detection_averaged",)]
    tables += [("classes", label) for label in expected["classes"]]
    for path in tables:
        ours, theirs = got, expected
        for key in path:
            ours, theirs = ours[key], theirs[key]
        assert set(ours) == set(theirs), path
        for field, value in theirs.items():
            assert ours[field] == pytest.approx(value, rel=0, abs=TOLERANCE), (path, field)


def test_what_the_labels_cannot_judge_is_left_out():
    got = score(FOLDER / "tao_rules")["classes"]
    counted = {
        label: tuple(int(s[k]) for k in ("CLR_TP", "CLR_FN", "CLR_FP", "IDSW"))
        for label, s in got.items()
    }
    # Reasons stand beside the rows in `freeze_federated.RULES`.
    assert counted == {
        "acorn": (4, 0, 1, 0),
        "aerosol_can": (2, 1, 2, 1),
        "air_conditioner": (2, 1, 0, 0),
    }
    whole = evaluate(FOLDER / "tao_rules" / "gt.json", FOLDER / "tao_rules" / "pred.json").scores()
    assert (whole["Dets"], whole["GT_Dets"]) == (18, 10)


def test_truth_that_says_nothing_of_its_labels_is_complete(tmp_path: Path):
    truth = read_json(FOLDER / "tao_rules" / "gt.json")
    for video in truth["videos"]:
        del video["neg_category_ids"], video["not_exhaustive_category_ids"]
    (tmp_path / "gt.json").write_text(json.dumps(truth))
    plain = evaluate(tmp_path / "gt.json", FOLDER / "tao_rules" / "pred.json")
    federated = evaluate(FOLDER / "tao_rules" / "gt.json", FOLDER / "tao_rules" / "pred.json")
    assert plain.federated is None
    assert "federated" not in plain.to_json()
    assert plain.to_json()["metrics"] == federated.to_json()["metrics"]


def test_predictions_without_classes_are_told(tmp_path: Path):
    truth = FOLDER / "tao_random_1" / "gt.json"
    (tmp_path / "pred").mkdir()
    for video in read_json(truth)["videos"]:
        (tmp_path / "pred" / f"{video['name'].split('/')[-1]}.txt").write_text("1,1,2,3,10,10,1\n")
    evaluation = evaluate(truth, tmp_path / "pred")
    assert evaluation.federated is None
    assert any("predictions name no class of the truth" in note for note in evaluation.notes)


def test_best_detections_of_an_image_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("remind_jax.metrics.formats.json_tracks.MAX_DETECTIONS", 2)
    answers = read_json(FOLDER / "tao_rules" / "pred.json")
    first = [row for row in answers if row["image_id"] == 100]
    for place, row in enumerate(first):
        row["score"] = place / 10
    (tmp_path / "pred.json").write_text(json.dumps(answers))
    truth = open_scenes(FOLDER / "tao_rules" / "gt.json")
    rows = open_scenes(tmp_path / "pred.json", truth=truth).read["known"]()
    assert sorted(rows.track_id[rows.frame == 0]) == sorted(r["track_id"] for r in first[-2:])


def test_boxes_of_federated_truth_are_those_written(tmp_path: Path):
    truth = read_json(FOLDER / "tao_rules" / "gt.json")
    for row in truth["annotations"]:
        left, top, width, height = row["bbox"]
        right, bottom = left + width + 3, top + height + 3
        row["segmentation"] = [[left, top, right, top, right, bottom, left, bottom]]
    (tmp_path / "gt.json").write_text(json.dumps(truth))
    got = evaluate(tmp_path / "gt.json", FOLDER / "tao_rules" / "pred.json").to_json()
    assert_equal(got["federated"], read_json(FOLDER / "tao_rules" / "expected.json"))
