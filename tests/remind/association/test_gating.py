"""Which pairs are open to assignment, and with what score (method.md#gating)."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.association.gating import (
    ContextVerdict,
    Gate,
    Pairs,
    gate_pairs,
    initial_pairs,
    read_context,
)
from remind_jax.remind.context.influence import no_influence
from remind_jax.remind.context.reasoning import Reasoning
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.association import Matching
from remind_jax.remind.thresholds.context import Influence

GATE = jax.jit(gate_pairs)


def build(
    score: Any,
    *,
    bonus: Any = 0.0,
    open_to_context: Any = True,
    used: Any = False,
    rows: Any = True,
    plausible: Any = True,
    candidate: Any = True,
    influences: bool = True,
    before: Pairs | None = None,
    **changed: bool,
) -> Pairs:
    """One table; everything is broadcast to the shape of `score`, `[N, O]`."""
    score = np.atleast_2d(np.asarray(score, float))
    num, width = score.shape
    full = lambda value, *shape: jnp.broadcast_to(jnp.asarray(value), shape)  # noqa: E731
    context = ContextVerdict(
        plausible=full(plausible, num, width),
        bonus_raw=full(np.asarray(bonus, float), width),
        supported=jnp.zeros(width, bool),
        rules=jax.tree.map(jnp.asarray, Influence(enabled=influences, rescue_visual=0.60)),
    )
    t = jax.tree.map(jnp.asarray, dataclasses.replace(Matching(), **changed))  # pyright: ignore[reportArgumentType]
    pairs = before or initial_pairs(jnp.asarray(score))
    return jax.device_get(
        GATE(
            pairs, full(candidate, num, width), jnp.asarray(score), context,
            full(open_to_context, num), full(rows, num), full(used, width), t,
        )
    )  # fmt: skip


@pytest.mark.parametrize(
    ("given", "gate", "final"),
    [
        ({"score": 0.80}, Gate.PASS_MATCH_THR, 0.80),
        ({"score": 0.75}, Gate.PASS_MATCH_THR, 0.75),
        ({"score": 0.74}, Gate.BLOCK_MATCH_THR, 0.74),
        ({"score": 0.59}, Gate.BLOCK_MIN_MATCH, 0.59),
        ({"score": 0.80, "used": True}, Gate.BLOCK_USED_OBJECT, 0.80),
        ({"score": 0.74, "used": True}, Gate.BLOCK_MATCH_THR, 0.74),
        ({"score": 0.80, "plausible": False}, Gate.NONE, 0.80),
        ({"score": 0.80, "candidate": False}, Gate.NONE, 0.80),
        ({"score": 0.66, "bonus": 0.10}, Gate.SETS_RESCUE, 0.76),
        ({"score": 0.64, "bonus": 0.10}, Gate.BLOCK_MATCH_THR, 0.64),
        ({"score": 0.59, "bonus": 0.20}, Gate.BLOCK_MIN_MATCH, 0.59),
        ({"score": 0.66, "bonus": 0.10, "open_to_context": False}, Gate.BLOCK_MATCH_THR, 0.66),
        ({"score": 0.66, "bonus": 0.10, "influences": False}, Gate.BLOCK_MATCH_THR, 0.66),
        ({"score": 0.80, "bonus": 0.10}, Gate.PASS_MATCH_THR, 0.90),
        ({"score": 0.80, "bonus": -0.10}, Gate.PASS_MATCH_THR, 0.70),
        ({"score": 0.70, "gate_match": False}, Gate.PASS_MATCH_THR, 0.70),
        ({"score": 0.50, "gate_min_visual": False}, Gate.BLOCK_MATCH_THR, 0.50),
    ],
)
def test_gates(x64, given, gate, final):
    pairs = build(**given)
    assert Gate(pairs.gate[0, 0]) is gate
    assert pairs.eligible[0, 0] == (gate >= Gate.PASS_MATCH_THR)
    assert pairs.score_final[0, 0] == pytest.approx(final, abs=1e-12)


@pytest.mark.parametrize(
    ("said", "supported"),
    [
        ({}, False),
        ({"support": 0.1, "compat_band": True}, True),
        ({"support": 0.1}, False),
        ({"compat_band": True}, False),  # no support at all
        ({"score_sets": 0.1, "compat_band": True}, True),
        ({"score_sets": 0.20}, True),
        ({"score_sets": 0.19}, False),
        ({"support": 0.1, "compat_rel": 0.65, "kernel_raw": 0.10}, True),
        ({"support": 0.1, "compat_rel": 0.64, "kernel_raw": 0.10}, False),
        ({"support": 0.1, "compat_rel": 0.65, "kernel_raw": 0.09}, False),
    ],
)
def test_what_counts_as_support(x64, said, supported):
    felt = no_influence(2, jnp.dtype("float64"))
    felt = dataclasses.replace(
        felt,
        **{name: jnp.array([value, 0], getattr(felt, name).dtype) for name, value in said.items()},
    )
    nothing: Any = None
    reasoning = Reasoning(felt, jnp.ones((1, 2), bool), jnp.zeros((1, 2), jnp.int32), nothing)
    t = Thresholds().as_arrays(jnp.float64)
    verdict = read_context(reasoning, t.influence, t.ambiguous)
    assert verdict.supported.tolist() == [supported, False]
