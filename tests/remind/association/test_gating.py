"""Rules and switches that no frozen frame depends on.

Rules: method.md#gating, method.md#dummy-columns.
"""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from remind_jax.remind.association.assignment import dummy_scores
from remind_jax.remind.association.diagnosis import Evidence
from remind_jax.remind.context.influence import find_supported, no_influence
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.association import Matching
from tests.remind.association.tables import decide_frames, visual_frame
from tests.statics import change_parts


def test_without_its_gate_the_least_visual_score_closes_nothing(x64):
    thresholds = [
        change_parts(Thresholds(), matching={"gate_match": False, "gate_min_visual": gate})
        for gate in (True, False)
    ]
    pairs = decide_frames([visual_frame([{0: 0.50}])] * 2, thresholds).assignment.pairs
    assert pairs.eligible[:, 0, 0].tolist() == [False, True]


@pytest.mark.parametrize(
    ("said", "supported"),
    [
        ({"support": 0.1, "compat_band": True}, True),
        ({"support": 0.1}, False),
        ({"compat_band": True}, False),  # no support at all
        ({"score_sets": 0.1, "compat_band": True}, True),
    ],
)
def test_what_counts_as_support(x64, said, supported):
    felt = no_influence(2, jnp.dtype("float64"))
    felt = dataclasses.replace(
        felt,
        **{name: jnp.array([value, 0], getattr(felt, name).dtype) for name, value in said.items()},
    )
    t = Thresholds().as_arrays(jnp.float64)
    assert find_supported(felt, t).tolist() == [supported, False]


def test_uncertain_detections_give_way(x64):
    """The example of method.md#dummy-columns."""

    def price(confidence: float, status: int = 2, **changed: float) -> float:
        one = jnp.ones(1)
        evidence = Evidence(jnp.full(1, status), one, one, one, jnp.array([confidence]))
        t = jax.tree.map(jnp.asarray, dataclasses.replace(Matching(), **changed))
        return float(dummy_scores(evidence, t)[0])

    assert price(0.001238) == pytest.approx(0.249752, abs=1e-6)
    assert price(0.0, dummy_score=0.7) == 0.72  # capped
    assert (
        price(0.0, dummy_score=0.9, dummy_by_confidence=False) == 0.9
    )  # the cap is another rule's
    assert price(0.0, status=0) == pytest.approx(0.05)  # without a diagnosis
