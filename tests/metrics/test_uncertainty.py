from typing import Any

import numpy as np
import pytest

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.decisions import Decisions
from remind_jax.metrics.uncertainty import UncertaintyCounts, count_uncertainty, uncertainty_scores
from tests.metrics.golden import OUTCOMES, ROOT, read_json

GOLDEN = read_json(ROOT / "uncertainty.json")


def count(
    frame: np.ndarray, gt: np.ndarray, outcome: np.ndarray, ids: np.ndarray, shown: np.ndarray
) -> UncertaintyCounts:
    none = np.full(len(ids), NO_ID)
    return count_uncertainty(frame, gt, Decisions(outcome, ids, none, shown, np.zeros(shown.shape)))


def rows_of(case: dict[str, Any]) -> list[np.ndarray]:
    rows = []
    for frame in case["frames"]:
        seen = {d["gt"]: d for d in frame["det"] if d["gt"] is not None}
        for gt in frame["gt"]:
            d = seen.get(gt, {"decision": None})
            candidates = [i for i, _ in d.get("candidates", [])]
            shown = (candidates + [NO_ID] * 8)[:8]
            outcome = OUTCOMES.get(d["decision"], Outcome.EMPTY)
            rows.append((frame["frame"], gt, outcome, d.get("id", NO_ID), shown))
    return [np.array(column) for column in zip(*rows, strict=True)]


@pytest.mark.parametrize("name", GOLDEN)
def test_shares_equal_the_originals(name: str):
    counts = count(*rows_of(GOLDEN[name]))
    scores, expected = uncertainty_scores(counts), GOLDEN[name]["expected"]
    assert counts.observations == expected["n_cases"]
    assert scores["FirmShare"] == pytest.approx(expected["firm_share"])
    assert scores["AmbiguousShare"] == pytest.approx(expected["ambiguous_share"])
    assert scores["CandidateHitRate"] == pytest.approx(expected["set_hit"])
    total = scores["FirmShare"] + scores["AmbiguousShare"] + scores["WeakShare"]
    assert total == pytest.approx(1)


def test_shares_of_nothing_are_undefined():
    none = np.zeros(0, np.int64)
    scores = uncertainty_scores(count(none, none, none, none, np.zeros((0, 3), int)))
    assert np.isnan(scores["FirmShare"])
    assert np.isnan(scores["CandidateHitRate"])
