"""Closeness, rankings and the temporal diagnosis (method.md#plausible-score)."""

from __future__ import annotations

import jax.numpy as jnp

from remind_jax.decision import NUM_OPTIONS
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.undecided.temporal import prefer


def test_the_first_entry_stands():
    def entries(present, number):
        options, row = jnp.full((3, NUM_OPTIONS), number), jnp.full(3, number)
        return Undecided(jnp.array(present), options, options.astype(float), row.astype(float), row)

    merged = prefer(entries([True, False, False], 1), entries([True, True, False], 2))
    assert merged.present.tolist() == [True, True, False]
    assert merged.best.tolist()[:2] == [1, 2]
    assert merged.slot.tolist()[:2] == [[1] * 3, [2] * 3]
