from typing import Any

import numpy as np
import pytest

from remind_jax.metrics.combine import pool_counts, sum_counts
from remind_jax.metrics.recovery import (
    ANY_CLASS,
    NO_LABEL,
    Answers,
    collect_answers,
    count_recovery,
    find_reference,
    recovery_scores,
)
from remind_jax.metrics.sequence import TrackingSequence
from tests.metrics.golden import ROOT, read_json
from tests.metrics.tables import from_frames, sequence_from_answers

GOLDEN = read_json(ROOT / "recovery.json")
CASES = {case["name"]: case for case in GOLDEN["cases"]}


def answers_of(case: dict[str, Any]) -> Answers:
    classes = sorted({o["cls"] for o in case["objects"]} | set(case["pred_class"].values()))
    said = [p for o in case["objects"] for p in o["pred"] if p is not None]
    label_class = np.full(max(said, default=-1) + 1, ANY_CLASS)
    for label, name in case["pred_class"].items():
        label_class[int(label)] = classes.index(name)
    rows = [
        (frame, o["gt"], NO_LABEL if label is None else label, iou, classes.index(o["cls"]))
        for o in case["objects"]
        for frame, label, iou in zip(
            o["frames"], o["pred"], o.get("iou", [1.0] * len(o["frames"])), strict=True
        )
    ]
    frame, gt, label, iou, gt_class = (np.asarray(column) for column in zip(*rows, strict=True))
    return Answers(frame, gt, label, np.where(label == NO_LABEL, 0, iou), gt_class, label_class)


@pytest.mark.parametrize("name", CASES)
def test_golden_cases(name: str):
    answers, expected = answers_of(CASES[name]), CASES[name]["expected"]["one_to_one"]
    reference = find_reference(answers)
    objects = [str(number) for number in answers.objects]
    found = {o: None if r == NO_LABEL else r for o, r in zip(objects, reference, strict=True)}
    assert found == expected["reference"]
    counts = count_recovery(answers, reference)
    per_object = zip(counts.opportunities, counts.recovered, counts.hard_recovered, strict=True)
    assert {o: list(c) for o, c in zip(objects, per_object, strict=True)} == expected["per_object"]
    scores = recovery_scores(sum_counts(counts))
    for ours, theirs in (("Recovery", "recovery"), ("HardRecovery", "hard_recovery")):
        value = np.nan if expected[theirs] is None else expected[theirs]
        np.testing.assert_equal(float(scores[ours]), value)


def test_scenes_are_pooled_by_adding_counts():
    answers = [answers_of(CASES[name]) for name in GOLDEN["pooling"]["scenes"]]
    counts = [sum_counts(count_recovery(a, find_reference(a))) for a in answers]
    scores = recovery_scores(pool_counts(counts))
    expected = GOLDEN["pooling"]["expected"]
    assert scores["Opportunities"] == expected["opportunities"]
    assert scores["Recovery"] == expected["recovery"]
    assert scores["HardRecovery"] == expected["hard_recovery"]


def test_a_return_may_need_a_longer_absence():
    answers = collect_answers(sequence_from_answers("aaa.a....aa..b"))
    counts = [
        sum_counts(count_recovery(answers, find_reference(answers), least))
        for least in (1, 2, 3, 5)
    ]
    assert [float(one.opportunities) for one in counts] == [3, 2, 1, 0]
    assert [float(one.recovered) for one in counts] == [2, 1, 1, 0]


def test_weak_overlaps_answer_only_if_admitted():
    sequence = from_frames([[1], [], [1]], [[4], [], [4]], [[[0.3]], [[]], [[0.3]]])
    assert collect_answers(sequence).label.tolist() == [NO_LABEL, NO_LABEL]


def test_a_prediction_of_another_class_answers_too():
    sequence = TrackingSequence.create(
        1,
        ([0], [1]),
        ([0], [4]),
        ([0], [0], [1.0]),
        gt_class=[0],
        pred_class=[1],
        class_names=("cup", "box"),
    )
    assert collect_answers(sequence).label.tolist() == [0]
