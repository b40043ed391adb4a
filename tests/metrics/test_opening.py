"""The same two scenes give the same scores in every format and in every mixture of formats."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from remind_jax.errors import SourceError
from remind_jax.metrics import evaluate
from remind_jax.metrics.opening import open_scenes
from remind_jax.metrics.scene_evaluation import SceneOptions
from tests.formats import scenes as made
from tests.formats.scenes import ANSWERS, TRUTH

Writer = Callable[[Path, dict[str, list[str]]], Path]


def _texts(spell: Callable[[list[str]], str]) -> Writer:
    return lambda root, scenes: made.write_texts(root, {n: spell(r) for n, r in scenes.items()})


def _json(spell: Callable[[Any], Any]) -> Writer:
    return lambda root, scenes: made.write_json(root.with_suffix(".json"), spell(scenes))


def _scene_folders(root: Path, scenes: dict[str, list[str]]) -> Path:
    for name, rows in scenes.items():
        made.write_maps(root / name / "Annotations", {name: rows})
    return root


WRITERS: dict[str, tuple[str, Writer]] = {
    "mot": ("mot", _texts(made.mot_text)),
    "mots": ("mots", _texts(made.mots_text)),
    "kitti-mots": ("kitti-mots", _texts(lambda rows: made.mots_text(rows, 0))),
    "maps": ("davis", made.write_maps),
    "davis": ("davis", made.write_davis),
    "scene folders": ("davis", _scene_folders),
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
    prediction_path = WRITERS[prediction][1](tmp_path / "prediction", ANSWERS)
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


def test_kitti_mots_that_begins_without_objects_counts_from_zero(tmp_path: Path):
    whole = made.write_texts(tmp_path / "a", {"s": made.mots_text(TRUTH["one"], 0)})
    rows = made.mots_text(TRUTH["one"], 0).splitlines()
    late = [row for row in rows if not row.startswith("0 ")]
    later = made.write_texts(tmp_path / "b", {"s": "\n".join(late)})
    for truth, prediction in ((whole, later), (later, whole)):
        evaluation = evaluate(truth, prediction)
        assert evaluation.scores()["IDTP"] == len(late)
        assert any(f"'{later}' has no frame 0" in note for note in evaluation.notes)


def test_mots_of_a_run_beside_kitti_truth_is_read_as_told(tmp_path: Path):
    truth = made.write_texts(tmp_path / "a", {"s": made.mots_text(TRUTH["one"], 0)})
    run = made.write_texts(tmp_path / "b", {"s": made.mots_text(TRUTH["one"], 1)})
    told = evaluate(truth, run, truth_format="kitti-mots", format="mots")
    assert (told.scores()["IDF1"], told.notes) == (1.0, ())


def test_maps_of_a_sampled_run_count_as_in_the_source_on_either_side(tmp_path: Path):
    maps = made.write_davis(tmp_path / "maps", {"one": TRUTH["one"]})
    labels = {"id_to_label": {"1": "cup_1", "2": "cup_2"}, "frame_numbers": [3, 5, 7, 9]}
    (maps / "metadata.json").write_text(json.dumps(labels))
    whole = [row for shown in TRUTH["one"] for row in ("......", shown)]
    text = made.write_texts(tmp_path / "text", {"one": made.mot_text(["......"] * 2 + whole)})
    for truth, prediction in ((text, maps), (maps, text)):
        assert evaluate(truth, prediction).scores()["IDF1"] == 1.0


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
    rows = made.coco_results(ANSWERS)
    others = [row | {"video_id": row["video_id"] + 70} for row in rows]
    with pytest.raises(SourceError, match="none of a video that is named"):
        evaluate(truth, made.write_json(tmp_path / "others.json", others))


@pytest.mark.parametrize("key", ["id", "name"])
def test_videos_that_cannot_be_told_apart_are_refused(tmp_path: Path, key: str):
    data = made.coco_video(TRUTH)
    first, second = data["videos"]
    second[key] = first[key]
    with pytest.raises(SourceError, match="two have the id"):
        open_scenes(made.write_json(tmp_path / "truth.json", data))


def test_wrong_classes_of_one_data_set_are_wrong(tmp_path: Path):
    data = made.coco_video(TRUTH)
    names = ("cup", "plate", "none of these")
    data["categories"] = [{"id": id, "name": name} for id, name in enumerate(names, 1)]
    data["annotations"] = [row | {"category_id": 2} for row in data["annotations"]]
    truth = made.write_json(tmp_path / "truth.json", data)
    rows = [row | {"category_id": 1} for row in made.coco_results(ANSWERS)]
    results = made.write_json(tmp_path / "results.json", rows)
    classes = evaluate(truth, results, options=SceneOptions(by_class=True)).to_json()["classes"]
    found = {name: (one["GT_Dets"], one["Dets"]) for name, one in classes.items()}
    assert found == {"cup": (0, 10), "plate": (10, 0)}


@pytest.mark.parametrize("change", [lambda shapes: shapes[1:], lambda shapes: [*shapes, None]])
def test_tracks_of_fewer_or_more_frames_than_their_video_are_refused(tmp_path: Path, change: Any):
    data = made.coco_video(TRUTH)
    for one in data["annotations"]:
        one["segmentations"] = change(one["segmentations"])
    other = made.write_json(tmp_path / "other.json", data)
    truth = made.write_json(tmp_path / "truth.json", made.coco_video(TRUTH))
    with pytest.raises(SourceError, match=r"frames, its video '.*; give a shape for each frame"):
        evaluate(truth, other)


def test_one_scene_matches_one_scene_whatever_their_names(tmp_path: Path):
    truth = made.write_maps(tmp_path / "truth", {"one": TRUTH["one"]})
    (tmp_path / "out.txt").write_text(made.mot_text(ANSWERS["one"]))
    evaluation = evaluate(truth / "one", tmp_path / "out.txt")
    assert evaluation.name == "out"
    assert evaluation.scores()["IDTP"] == 6
