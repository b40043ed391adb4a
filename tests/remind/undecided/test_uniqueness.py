"""No object in two places: of two claims the better one stands, for any frame."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from remind_jax.decision import Reason
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.undecided import competition

NUM, SLOTS = 6, 4


@pytest.fixture
def scored(monkeypatch):
    """Lets the scores of pairs be given with the account."""
    monkeypatch.setattr(competition, "temporal_score", lambda account, members: account.score)


def withdraw(slot, score, plausible=None, final=None, enabled=True) -> Any:
    plausible = np.ones((NUM, SLOTS), bool) if plausible is None else plausible
    account: Any = SimpleNamespace(
        plausible=plausible,
        score=np.zeros((NUM, SLOTS)) if final is None else final,
        thresholds=SimpleNamespace(
            matching=SimpleNamespace(one_detection_each=np.array(enabled)),
            ambiguous=SimpleNamespace(max_candidates=np.array(3)),
        ),
    )
    return competition.withdraw_second_claims(account, np.asarray(slot), np.asarray(score))


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32 - 1))
def test_every_object_keeps_its_best_claim_only(scored, seed):
    rng = np.random.default_rng(seed)
    slot = rng.integers(-1, SLOTS, NUM)
    score = rng.integers(0, 3, NUM) / 2.0
    plausible, final = rng.random((NUM, SLOTS)) < 0.6, rng.random((NUM, SLOTS))
    entries = withdraw(slot, score, plausible, final)
    left = np.where(entries.present, NO_SLOT, slot)
    for wanted in range(SLOTS):
        claims = np.flatnonzero(slot == wanted)
        kept = np.flatnonzero(left == wanted)
        assert kept.tolist() == ([claims[np.argmax(score[claims])]] if len(claims) else [])
    for row in np.flatnonzero(entries.present):
        named = [int(at) for at in entries.slot[row] if at != NO_SLOT]
        others = [int(at) for at in np.argsort(-final[row]) if plausible[row, at]]
        assert named == [slot[row], *(at for at in others if at != slot[row])][:3]
        assert entries.reason[row] == Reason.KNOWN_BUT_HELD_BY_BETTER_MATCH
    assert not entries.present[slot == NO_SLOT].any()


def test_nothing_is_withdrawn_as_published(scored):
    assert not withdraw([0, 0, 0, 1, 1, -1], np.zeros(NUM), enabled=False).present.any()
