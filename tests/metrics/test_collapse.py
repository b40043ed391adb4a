import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.decision import NO_ID, Outcome
from remind_jax.formats.firm import keep_unique
from remind_jax.metrics.collapse import PROVISIONAL_BASE, collapse_frame
from remind_jax.metrics.decisions import Decisions


def collapse(*rows: tuple[Outcome, int, dict[int, float]]) -> list[int]:
    """Outcome, firm or pending id, candidates with scores."""
    width = max(len(candidates) for _, _, candidates in rows)
    ids, scores = np.full((len(rows), width), NO_ID), np.zeros((len(rows), width))
    for row, (_, _, candidates) in enumerate(rows):
        ids[row, : len(candidates)] = list(candidates)
        scores[row, : len(candidates)] = list(candidates.values())
    outcome = np.array([row[0] for row in rows])
    given_id = np.array([row[1] for row in rows])
    is_firm = np.isin(outcome, [Outcome.MATCH, Outcome.NEW])
    firm, pending = np.where(is_firm, given_id, NO_ID), np.where(is_firm, NO_ID, given_id)
    return collapse_frame(Decisions(outcome, firm, pending, ids, scores)).tolist()


def test_firm_ids_are_taken():
    firm, soft = (Outcome.MATCH, 8, {}), (Outcome.AMBIGUOUS, 0, {8: 0.9, 7: 0.2})
    assert collapse(firm, soft) == [8, 7]
    assert collapse(firm, (Outcome.AMBIGUOUS, 0, {8: 0.9})) == [8, NO_ID]


def test_nobody_leaves_its_candidate_set():
    # The case in which the original hands out an id that was no candidate.
    rows = (
        (Outcome.MATCH, 7, {}),
        (Outcome.AMBIGUOUS, 0, {7: 0.9}),
        (Outcome.AMBIGUOUS, 1, {9: 0.5, 8: 0.4}),
    )
    assert collapse(*rows) == [7, NO_ID, 9]


def test_provisional_tracks_are_called_by_their_own_id():
    assert collapse((Outcome.PROVISIONAL_NEW, 3, {7: 0.9})) == [PROVISIONAL_BASE + 3]
    assert collapse((Outcome.UNASSIGNED, NO_ID, {7: 0.9})) == [NO_ID]


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**31))
def test_collapse_is_the_best_of_all(seed: int):
    rng = np.random.default_rng(seed)
    num = 4
    outcome = rng.choice([Outcome.MATCH, Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT], num)
    firm_ids = np.where(outcome == Outcome.MATCH, 10 + rng.permutation(num), NO_ID)
    ids = np.stack([10 + rng.permutation(5)[:3] for _ in range(num)])
    ids[rng.random(ids.shape) < 0.3] = NO_ID
    scores = rng.random(ids.shape)
    got = collapse_frame(Decisions(outcome, firm_ids, np.full(num, NO_ID), ids, scores))

    taken = set(firm_ids.tolist()) - {NO_ID}
    soft = np.flatnonzero(outcome != Outcome.MATCH)
    options = [
        [(NO_ID, 0.0)]
        + [
            (i, s)
            for i, s in zip(ids[r].tolist(), scores[r], strict=True)
            if i not in {NO_ID, *taken}
        ]
        for r in soft
    ]
    best = (-1, 0.0)
    for choice in itertools.product(*options):
        chosen = [i for i, _ in choice if i != NO_ID]
        if len(set(chosen)) == len(chosen):
            best = max(best, (len(chosen), sum(s for _, s in choice)))
    picked = [
        dict(o)[int(got[r])] for r, o in zip(soft, options, strict=True)
    ]  # a candidate, or none
    assert sum(int(got[r]) != NO_ID for r in soft) == best[0]
    assert sum(picked) == pytest.approx(best[1])
    assert got[outcome == Outcome.MATCH].tolist() == firm_ids[outcome == Outcome.MATCH].tolist()


def test_of_two_claims_the_better_scored_is_kept():
    label = np.array([5, 5, NO_ID, 6, 6])
    keep = keep_unique(label, np.array([0.7, 0.9, 1.0, 0.8, 0.8]))
    assert keep.tolist() == [False, True, False, True, False]
