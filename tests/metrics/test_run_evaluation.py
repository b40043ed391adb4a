"""A run scored against truth from elsewhere equals the run scored by the truth it carries."""

import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from remind_jax.decision import NO_ID, Outcome
from remind_jax.errors import SourceError
from remind_jax.formats.coco_tracks import coco_video
from remind_jax.formats.cvat import to_cvat
from remind_jax.formats.instance_maps import write_instance_maps
from remind_jax.formats.mot import mot_lines
from remind_jax.masks.run_length import decode_mask, encode_masks
from remind_jax.metrics import SceneOptions, evaluate, evaluate_tracks
from remind_jax.metrics.paper_evaluation import evaluate_paper, paper_table
from remind_jax.outputs.store import DETECTIONS_NAME, detections_writer
from remind_jax.tracks import Tracks
from tests.formats import scenes as made
from tests.formats.scenes import CLASSES
from tests.outputs.fake_run import make_info, make_tracks

LINES = ["11.22.", "11.22.", "11....", "11.22.", ".1122."]
OUTCOMES = {"n": Outcome.NEW, "m": Outcome.MATCH, "a": Outcome.AMBIGUOUS, "-": Outcome.UNASSIGNED}
# Object 2 is undecided when it returns, then known; object 1 is lost for a frame.
DECIDED = ["n7 n8", "m7 m8", "-0", "m7 a0", "m7 m8"]


def make_run() -> list[Tracks]:
    return [
        _frame(at, line, said) for at, (line, said) in enumerate(zip(LINES, DECIDED, strict=True))
    ]


def every_second() -> list[Tracks]:
    return [dataclasses.replace(frame, frame_index=at) for at, frame in enumerate(make_run()[::2])]


def _frame(at: int, line: str, said: str) -> Tracks:
    labels = made.label_maps([line])[0]
    numbers = np.unique(labels[labels > 0]).tolist()
    rows = [
        {
            "instance_id": number,
            "label": CLASSES[number],
            "outcome": OUTCOMES[kind],
            "object_id": int(given) if kind in "nm" else NO_ID,
            "candidates": [(8, 0.9), (7, 0.8)] if kind == "a" else [],
        }
        for number, (kind, given) in zip(numbers, said.split(), strict=True)
    ]
    tracks = make_tracks(at, labels == np.array(numbers)[:, None, None], rows)
    return dataclasses.replace(tracks, source_index=at, name=f"{at:05d}.jpg")


def save(folder: Path, run: list[Tracks]) -> Path:
    folder.mkdir()
    with detections_writer(folder / DETECTIONS_NAME, make_info()) as file:
        for tracks in run:
            file.add(tracks)
    return folder


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    return made.write_davis(tmp_path / "truth", {"rooms": LINES})


@pytest.mark.parametrize("undecided", ["strict", "collapse"])
def test_equals_the_run_scored_alone(tmp_path: Path, truth: Path, undecided: Any):
    run = make_run()
    folder = save(tmp_path / "run", run)
    options = SceneOptions(undecided=undecided, by_class=True)
    got = evaluate(truth, folder, options=options)
    expected = evaluate_tracks(run, undecided=undecided, by_class=True)
    scores = got.pooled.scores()
    for name, value in expected.scores().items():
        assert scores[name] == pytest.approx(value, abs=1e-12, nan_ok=True), name
    assert got.to_json()["classes"]["cup"]["IDTP"] == expected.by_class["cup"].scores()["IDTP"]
    assert got.intervals(num_resamples=20) == expected.intervals(num_resamples=20)
    assert scores["CandidateHitRate"] == 1.0
    assert scores["Recovery"] == 1.0
    assert scores["HardRecovery"] == 0.0


def test_only_processed_frames_are_evaluated(tmp_path: Path, truth: Path):
    evaluation = evaluate(truth, save(tmp_path / "run", every_second()))
    assert evaluation.notes == ("3 of 5 frames were processed",)
    assert evaluation.scores()["GT_Dets"] == 5


def test_frames_that_a_file_of_tracks_lacks_are_told(tmp_path: Path, truth: Path):
    run, classes = make_run()[::2], [*CLASSES.values()]
    coco, cvat = tmp_path / "coco_video.json", tmp_path / "cvat.xml"
    coco.write_text(json.dumps(coco_video(run, classes, "rooms", 10.0)))
    cvat.write_bytes(to_cvat(run, "rooms", classes, run[0].frame_size))
    for path in (coco, cvat):
        (note,) = evaluate(truth, path).notes
        assert note.startswith("2 of 5 frames are not in the predictions and count as missed")


def test_outputs_of_one_strided_run_agree_whichever_is_the_truth(tmp_path: Path):
    run, classes = every_second(), [*CLASSES.values()]
    folder, mot, cvat = save(tmp_path / "run", run), tmp_path / "mot.txt", tmp_path / "cvat.xml"
    coco = tmp_path / "coco_video.json"
    mot.write_text("\n".join(mot_lines(run)))
    cvat.write_bytes(to_cvat(run, "run", classes, run[0].frame_size))
    coco.write_text(json.dumps(coco_video(run, classes, "run", 10.0)))
    for sides in itertools.permutations((folder, mot, cvat, coco), 2):
        assert evaluate(*sides).scores()["IDF1"] == 1.0, sides


def test_outputs_of_frames_of_two_sizes_agree_whichever_is_the_truth(tmp_path: Path):
    run, classes = make_run(), [*CLASSES.values()]
    for at in (3, 4):
        masks = np.array([decode_mask(rle) for rle in run[at].rles]) > 0
        twice = encode_masks(masks.repeat(2, axis=1).repeat(2, axis=2))
        size = (2 * run[at].frame_size[0], 2 * run[at].frame_size[1])
        run[at] = dataclasses.replace(
            run[at], frame_size=size, rles=twice, boxes=2 * run[at].boxes, areas=4 * run[at].areas
        )
    folder, cvat, coco = save(tmp_path / "run", run), tmp_path / "cvat.xml", tmp_path / "coco.json"
    cvat.write_bytes(to_cvat(run, "run", classes, run[0].frame_size))
    coco.write_text(json.dumps(coco_video(run, classes, "run", 10.0)))
    write_instance_maps(run, "run", tmp_path / "maps" / "run")
    for sides in itertools.permutations((folder, cvat, coco, tmp_path / "maps"), 2):
        assert evaluate(*sides).scores()["IDF1"] == 1.0, sides


def test_what_a_tracker_does_not_rate_counts_as_sure():
    masks = np.ones((1, 4, 6), bool)
    new = {"object_id": 0, "outcome": Outcome.NEW, "score": 0.0, "confidence": 0.0}
    run = [make_tracks(0, masks, [new]), make_tracks(1, masks, [{"object_id": 0}])]
    (annotation,) = coco_video(run, ["cup"], "run", 10.0)["annotations"]
    assert annotation["score"] == pytest.approx(0.9)  # of 1 and 0.8
    assert [line.split(",")[6] for line in mot_lines(run)] == ["1.0000", "0.8000"]


def test_undecided_detections_beside_the_truth_are_no_observations(tmp_path: Path, truth: Path):
    run = make_run()
    stray = np.zeros((1, made.HEIGHT, 6), bool)
    stray[:, :, 5] = True
    run[2] = dataclasses.replace(run[2], rles=encode_masks(stray))
    scores = evaluate(truth, save(tmp_path / "run", run)).scores()
    assert scores["FirmShare"] == pytest.approx(7 / 9)
    assert scores["WeakShare"] == pytest.approx(1 / 9)


def test_the_paper_protocol_scores_a_run_both_ways(tmp_path: Path, truth: Path):
    remind, generic = evaluate_paper(truth, save(tmp_path / "run", make_run()), name="ours")
    ours, other = remind.scores(), generic.scores()
    # Two births cost an observation each, object 1 is lost once, the candidates are settled well.
    assert (ours["IDTP"], ours["IDFP"], ours["IDFN"]) == (6, 2, 3)
    assert (ours["AmbiguousShare"], ours["CollapseAccuracy"]) == (pytest.approx(1 / 9), 1.0)
    assert (other["IDTP"], other["IDFP"], other["IDFN"]) == (7, 0, 2)
    assert ours["Recovery"] == other["Recovery"] == 1.0
    assert "AmbiguousShare" not in other
    table = paper_table([remind, generic])
    assert "Rows of different formulas do not compare." in table.legend
    assert any("birth" in sentence for sentence in table.legend)
    assert remind.to_json()["protocol"] == "paper"


def test_the_paper_protocol_leaves_classes_out(tmp_path: Path, truth: Path):
    (truth / "metadata.json").write_text('{"id_to_label": {"1": "wall_1", "2": "cup_2"}}')
    prediction = made.write_maps(tmp_path / "prediction", {"rooms": LINES})
    (generic,) = evaluate_paper(truth, prediction)
    assert generic.scores()["GT_Dets"] == 4


def test_a_part_of_a_run_is_no_answer(tmp_path: Path, truth: Path):
    folder = save(tmp_path / "run", make_run())
    with pytest.raises(SourceError, match=r"part of a run; give the folder '.*run'"):
        evaluate(truth, folder / DETECTIONS_NAME)


def test_a_folder_of_cvat_files_is_many_scenes(tmp_path: Path):
    run = make_run()
    for name in ("one", "two"):
        file = tmp_path / "cvat" / f"{name}.xml"
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(to_cvat(run, name, [*CLASSES.values()], run[0].frame_size))
    assert evaluate(tmp_path / "cvat", tmp_path / "cvat").scores()["Scenes"] == 2
