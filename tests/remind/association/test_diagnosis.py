"""Status, confidence and anchors (method.md#reliable-anchors, method.md#status)."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.association.diagnosis import Evidence, diagnose
from remind_jax.remind.thresholds.association import Diagnosis

DIAGNOSE = jax.jit(diagnose, static_argnames="margin")
WIDTH = 4


def table(*rows: list[float]) -> tuple[np.ndarray, np.ndarray]:
    scores, counted = np.zeros((len(rows), WIDTH)), np.zeros((len(rows), WIDTH), bool)
    for n, row in enumerate(rows):
        scores[n, : len(row)], counted[n, : len(row)] = row, True
    return scores, counted


def look(*scores: float, num_terms: int = 1, **changed: object) -> Evidence:
    t = jax.tree.map(jnp.asarray, dataclasses.replace(Diagnosis(), **changed))  # pyright: ignore[reportArgumentType]
    evidence = DIAGNOSE(*table(list(scores)), np.array([num_terms], np.int32), "sigmoid", t)
    return jax.tree.map(lambda leaf: leaf[0].item(), evidence)


def test_divisors_too_small_are_replaced(x64):
    """method.md#confidence: what does not exceed `small` gives way."""

    def confidence(**changed: float) -> float:
        return look(0.8, 0.7, num_terms=3, **changed).confidence  # pyright: ignore[reportReturnType]

    assert confidence(temperature=1e-9, temperature_least=0.3) == confidence(temperature=0.3)
    assert confidence(gap_scale=1e-9, gap_scale_least=0.3) == confidence(gap_scale=0.3)
    # 1 - 0.7, the room above the others, is divided by only as far as it exceeds `small`.
    wide = {"temperature": 0.7, "gap_scale": 0.7}
    assert confidence(small=0.6, **wide) == pytest.approx(confidence(**wide) * 0.3 / 0.6)
