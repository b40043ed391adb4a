"""Breakdowns of text against text: the same as of instance maps, as far as the text tells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from remind_jax.metrics import SetEvaluation, evaluate
from remind_jax.metrics.breakdowns import SIZE_BINS, Breakdown
from remind_jax.metrics.text_evaluation import SIZE_UNKNOWN, read_frame_size, share_of_frame
from tests.metrics.formats import scenes as made
from tests.metrics.formats.scenes import ANSWERS, HEIGHT, TRUTH

INFO = "[Sequence]\nname=x\nimWidth={}\nimHeight={}\n"


def write_challenge(root: Path, *, with_info: bool = True, class_id: str = "1") -> Path:
    """`<scene>/gt/gt.txt` with `<scene>/seqinfo.ini`, as MOTChallenge has it."""
    for name, rows in TRUTH.items():
        (root / name / "gt").mkdir(parents=True)
        lines = [line.split(",") for line in made.mot_text(rows).splitlines()]
        for line in lines:
            line[7] = class_id if class_id != "by id" else line[1]
        text = "".join(",".join(line) + "\n" for line in lines)
        (root / name / "gt" / "gt.txt").write_text(text)
        if with_info:
            (root / name / "seqinfo.ini").write_text(INFO.format(len(rows[0]), HEIGHT))
    return root


def score_mot(root: Path, **options: str | bool) -> SetEvaluation:
    truth = write_challenge(root / "truth", **options)  # pyright: ignore[reportArgumentType]
    texts = {name: made.mot_text(rows) for name, rows in ANSWERS.items()}
    return evaluate(truth, made.write_texts(root / "answers", texts))


def as_lists(breakdown: Breakdown) -> tuple[list[int], ...]:
    counts = (breakdown.observations, breakdown.answered, breakdown.right)
    return tuple(count.tolist() for count in counts)


def test_boxes_and_masks_break_down_alike(tmp_path: Path):
    maps = evaluate(
        made.write_maps(tmp_path / "truth_maps", TRUTH),
        made.write_maps(tmp_path / "answer_maps", ANSWERS),
    ).pooled.breakdowns
    boxes = score_mot(tmp_path / "mot").pooled.breakdowns
    truth, answers = (
        made.write_texts(tmp_path / side, {n: made.mots_text(r) for n, r in scenes.items()})
        for side, scenes in (("truth", TRUTH), ("answers", ANSWERS))
    )
    masks = evaluate(truth, answers).pooled.breakdowns
    for name in ("visible", "size"):
        assert as_lists(boxes[name]) == as_lists(masks[name]) == as_lists(maps[name])
    # Objects 1 and 2 are seen together in three frames.
    assert as_lists(boxes["distractors"]) == as_lists(masks["distractors"])
    assert boxes["distractors"].observations.tolist() == [4, 6, 0, 0, 0, 0, 0]
    assert (boxes["class"].bins, masks["class"].bins) == (("class 1",), ("pedestrian",))


def test_classes_of_boxes_make_distractors(tmp_path: Path):
    breakdowns = score_mot(tmp_path, class_id="by id").pooled.breakdowns
    assert breakdowns["distractors"].observations.tolist() == [10, 0, 0, 0, 0, 0, 0]
    assert breakdowns["class"].bins == ("class 1", "class 2", "class 3")


def test_what_text_does_not_tell_is_not_guessed(tmp_path: Path):
    evaluation = score_mot(tmp_path, with_info=False, class_id="-1")
    assert set(evaluation.pooled.breakdowns) == {"visible"}
    assert evaluation.notes == (f"one, two: {SIZE_UNKNOWN}",)


@pytest.mark.parametrize("text", ["", "[Sequence]\n", INFO.format(0, 4), INFO.format("x", 4), "x"])
def test_a_useless_seqinfo_is_none(tmp_path: Path, text: str):
    (tmp_path / "seqinfo.ini").write_text(text)
    assert read_frame_size(tmp_path / "gt.txt") is None


def test_only_what_lies_in_the_frame_counts(tmp_path: Path):
    (tmp_path / "seqinfo.ini").write_text(INFO.format(10, 4))
    assert read_frame_size(tmp_path / "gt.txt") == (4, 10)
    boxes = np.array([[-5.0, 0, 5, 4], [2, 1, 4, 3], [20, 0, 30, 4]])
    assert share_of_frame(boxes, (4, 10)).tolist() == [0.5, 0.1, 0.0]
    assert SIZE_BINS["huge"] == 0.1
