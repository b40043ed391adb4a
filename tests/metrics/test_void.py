"""Void (255) of DAVIS truth: its pixels belong to no object and to no prediction."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from remind_jax.formats.instance_maps import read_instance_maps
from remind_jax.metrics import evaluate
from remind_jax.metrics.pairing import PairedScene, pair_scene
from tests.metrics.golden import ROOT, TOLERANCE, read_json
from tests.sources import making

VOID = 255
CASES: dict[str, Any] = read_json(ROOT / "davis.json")


def write_maps(folder: Path, maps: Any) -> Path:
    for frame, labels in enumerate(np.asarray(maps, np.uint8)):
        making.write_image(folder / f"{frame:05d}.png", labels)
    return folder


def test_frames_follow_each_other_by_the_numbers_of_their_maps(tmp_path: Path):
    folder = write_maps(tmp_path / "truth", np.arange(1, 13)[:, None, None] * np.ones((1, 2, 2)))
    for file in folder.iterdir():
        file.rename(file.with_name(f"{int(file.stem)}.png"))
    rows = read_instance_maps(folder, "scene", is_truth=True)
    assert rows.track_id.tolist() == [*range(1, 13)]


def pair(root: Path, truth: Any, answers: Any) -> PairedScene:
    return pair_scene(
        read_instance_maps(write_maps(root / "truth", truth), "scene", is_truth=True),
        read_instance_maps(write_maps(root / "answers", answers), "scene", is_truth=False),
    )


def overlap_of_davis(truth: np.ndarray, answers: np.ndarray, number: int, label: int) -> float:
    """The region measure J of DAVIS 2017: intersection over union outside of void."""
    seen, said, known = truth == number, answers == label, truth != VOID
    return float((seen & said & known).sum() / ((seen | said) & known).sum())


@pytest.mark.parametrize("name", CASES)
def test_overlaps_are_those_of_davis(tmp_path: Path, name: str):
    case = CASES[name]
    truth, answers = (np.asarray(case[side]) for side in ("truth", "answers"))
    sequence = pair(tmp_path, truth, answers).sequence
    assert len(sequence.pair_gt) > 5
    for row, column, overlap in zip(
        sequence.pair_gt, sequence.pair_pred, sequence.pair_similarity, strict=True
    ):
        frame = sequence.gt.frame[row]
        ids = int(sequence.gt.id[row]), int(sequence.pred.id[column])
        expected = overlap_of_davis(truth[frame], answers[frame], *ids)
        assert overlap == pytest.approx(expected, rel=0, abs=1e-12)  # a ratio of whole numbers
    stored = sum(np.count_nonzero(matrix) for matrix in case["overlaps"])
    assert len(sequence.pair_gt) == stored


@pytest.mark.parametrize("name", CASES)
def test_scores_equal_trackeval_on_cut_masks(tmp_path: Path, name: str):
    case = CASES[name]
    truth = write_maps(tmp_path / "truth", case["truth"])
    scores = evaluate(truth, write_maps(tmp_path / "answers", case["answers"])).scores()
    for field, value in case["cut"].items():
        assert scores[field] == pytest.approx(value, rel=0, abs=TOLERANCE), field
    differs = any(abs(case["cut"][k] - v) > TOLERANCE for k, v in case["as_is"].items())
    assert differs == name.startswith("void")


def test_void_is_cut_at_the_scale_of_the_truth(tmp_path: Path):
    truth = np.zeros((1, 6, 8), np.uint8)
    truth[0, :, :3], truth[0, :, 3:5] = 1, VOID
    answers = np.kron(np.where(truth > 0, 7, 0), np.ones((1, 2, 2), int))
    paired = pair(tmp_path, truth, answers)
    assert paired.sequence.pair_similarity.tolist() == [1.0]


def test_void_says_nothing_to_boxes(tmp_path: Path):
    truth = np.zeros((1, 6, 8), np.uint8)
    truth[0, :, :3], truth[0, :, 3:5] = 1, VOID
    folder = write_maps(tmp_path / "truth", truth)
    (tmp_path / "p.txt").write_text("1,7,0,0,5,6,1\n")
    assert evaluate(folder, tmp_path / "p.txt").scores()["LocA(0)"] == pytest.approx(18 / 30)
    rows = read_instance_maps(folder, "scene", is_truth=True)
    assert rows.is_void
    assert pair_scene(rows, dataclasses.replace(rows, rles=None)).sequence.pred.id.tolist() == [1]
