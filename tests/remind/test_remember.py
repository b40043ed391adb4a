"""What memory may learn from the decisions of a frame; recorded traces have the memory itself."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np

from remind_jax.decision import Outcome, Status, no_decisions
from remind_jax.remind.remember import gate_updates
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Update
from tests.statics import make_static


def test_gated_updates_learn_from_clear_matches_only():
    """method.md#update-permit: a weak match teaches nothing, an ambiguous one a little."""
    blank = no_decisions(make_static(num_detections=3))
    decisions = dataclasses.replace(blank, outcome=np.array([Outcome.MATCH] * 3))
    status = np.array([Status.STRONG, Status.AMBIGUOUS, Status.WEAK])
    stages: Any = SimpleNamespace(status_final=status)
    t = Thresholds(update=Update(gated=True, ambiguous_rate=0.25)).as_arrays(jnp.float32)
    learns, permit = gate_updates(decisions, stages, t)
    assert learns.tolist() == [True, True, False]
    assert permit.insert.tolist() == [True, False, True]
    assert permit.rate.tolist() == [1.0, 0.25, 1.0]
    free, permit = gate_updates(decisions, stages, Thresholds().as_arrays(jnp.float32))
    assert free.all()
    assert permit.insert.all()
