import math
from typing import Any

import numpy as np
import pytest

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.decisions import NO_ROW, Decisions
from remind_jax.metrics.paper import (
    PaperCounts,
    Sightings,
    collapse_scene,
    count_generic,
    count_remind,
    paper_scores,
)
from tests.metrics.golden import OUTCOMES, ROOT, read_json

CASES: dict[str, Any] = read_json(ROOT / "original_evaluator.json")["cases"]
SCORES = {
    "idp": "IDP",
    "idr": "IDR",
    "idf1": "IDF1",
    "deta": "DetA",
    "assa": "AssA",
    "hota": "HOTA",
    "idsw_rate": "IDSWRate",
    "firm_share": "FirmShare",
    "firm_acc": "FirmAccuracy",
    "ambiguous_share": "AmbiguousShare",
    "set_hit": "CandidateHitRate",
    "amb_collapse_acc": "CollapseAccuracy",
}
# The original's solver went outside of the candidate set there; we never do.
SOLVER_DEPENDENT = [name for name, case in CASES.items() if case["solver_dependent"]]


def sightings_of(case: dict[str, Any]) -> Sightings:
    classes = sorted(set(case["classes"].values()) | {"table", "lamp"})
    gt = [(f["frame"], g) for f in case["frames"] for g in f["gt"]]
    dets = [(f["frame"], d) for f in case["frames"] for d in f["det"]]
    width = max([len(d.get("candidates", ())) for _, d in dets], default=0)
    ids, scores = np.full((len(dets), width), NO_ID), np.zeros((len(dets), width))
    for row, (_, d) in enumerate(dets):
        for rank, (number, score) in enumerate(d.get("candidates", ())):
            ids[row, rank], scores[row, rank] = number, score
    place = {key: at for at, key in enumerate(gt)}
    names = sorted({*classes, *(d["class"] for _, d in dets)})

    def column(values: list[Any], dtype: Any = np.int64) -> np.ndarray:
        return np.array(values, dtype)

    return Sightings(
        gt_frame=column([frame for frame, _ in gt]),
        gt_id=column([g for _, g in gt]),
        gt_class=column([names.index(case["classes"][str(g)]) for _, g in gt]),
        frame=column([frame for frame, _ in dets]),
        row=column([place.get((frame, d["gt"]), NO_ROW) for frame, d in dets]),
        iou=column([d["iou"] if d["gt"] is not None else 0.0 for _, d in dets], float),
        class_id=column([names.index(d["class"]) for _, d in dets]),
        decisions=Decisions(
            outcome=column([OUTCOMES[d["decision"]] for _, d in dets]),
            object_id=column([d.get("id", NO_ID) for _, d in dets]),
            pending_id=column([d.get("temp", NO_ID) for _, d in dets]),
            candidate_id=ids,
            candidate_score=scores,
        ),
    )


def assert_equal(counts: PaperCounts, expected: dict[str, Any]) -> None:
    got = paper_scores(counts)
    for name, field in SCORES.items():
        if name in expected:
            value = float(got[field])
            want = math.nan if expected[name] is None else expected[name]
            assert value == pytest.approx(want, abs=1e-12, nan_ok=True), name
    for name in ("idtp", "idfp", "idfn"):
        assert int(getattr(counts, name)) == expected[name], name
    assert (int(counts.switches), int(counts.fragments)) == (expected["idsw"], expected["frag"])
    returns = (counts.opportunities, counts.recovered, counts.hard_recovered)
    assert [int(n) for n in returns] == expected["recovery(opps,rec,hard)"]
    if "mt_pt_ml" in expected:
        tracked = (counts.mostly_tracked, counts.partly_tracked, counts.mostly_lost)
        assert [int(n) for n in tracked] == expected["mt_pt_ml"]


@pytest.mark.parametrize("name", [name for name in CASES if name not in SOLVER_DEPENDENT])
def test_hungarian_counts_as_the_original_does(name: str):
    case = CASES[name]
    assert_equal(count_remind(sightings_of(case)), case["expected"]["remind_hungarian"])


@pytest.mark.parametrize("name", list(CASES))
def test_other_trackers_count_as_in_the_original(name: str):
    case = CASES[name]
    assert_equal(count_generic(sightings_of(case)), case["expected"]["generic"])


@pytest.mark.parametrize("name", [name for name in CASES if name not in SOLVER_DEPENDENT])
def test_collapsed_ids_equal_those_of_the_original(name: str):
    case = CASES[name]
    sightings = sightings_of(case)
    collapsed = collapse_scene(sightings)
    of = {
        (int(sightings.gt_frame[row]), int(sightings.gt_id[row])): int(number)
        for row, number in zip(sightings.row, collapsed, strict=True)
        if row != NO_ROW
    }
    for frame, gt, _, number, _ in case["expected"]["remind_hungarian"]["collapsed"]:
        assert of.get((frame, gt), NO_ID) == (NO_ID if number is None else number)


def test_no_id_from_outside_of_a_candidate_set():
    (name,) = SOLVER_DEPENDENT
    sightings = sightings_of(CASES[name])
    collapsed = collapse_scene(sightings)
    soft = sightings.decisions.outcome == Outcome.AMBIGUOUS
    candidates = sightings.decisions.candidate_id[soft]
    for number, shown in zip(collapsed[soft], candidates, strict=True):
        assert number == NO_ID or number in shown
