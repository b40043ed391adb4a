"""`Thresholds`: every number that people tune, as one pytree of traced scalars.

A changed value never recompiles; a leaf with a leading axis is a sweep. Values are those of the
published tracker. "Effective patches" is the summed coverage of a mask in patches.
"""

from __future__ import annotations

import dataclasses

from remind_jax.numerics.pytree import pytree
from remind_jax.remind.thresholds.association import Diagnosis, Matching, Similarity
from remind_jax.remind.thresholds.context import Influence, Sets, Veto
from remind_jax.remind.thresholds.known_sets import KnownSets
from remind_jax.remind.thresholds.memory import Appearance, Background, Lifecycle, Parts, Update
from remind_jax.remind.thresholds.outcome import (
    Ambiguous,
    Competition,
    Pending,
    Provisional,
    Stability,
)
from remind_jax.remind.thresholds.perception import AttentionParts, Perception, RingPrototypes
from remind_jax.remind.thresholds.relations import Cooccurrence, Relations
from remind_jax.settings.arrays import AsArrays


@pytree
class Thresholds(AsArrays):
    """All traced numbers of the tracker by the stage that reads them."""

    perception: Perception = dataclasses.field(default_factory=Perception)
    appearance: Appearance = dataclasses.field(default_factory=Appearance)
    background: Background = dataclasses.field(default_factory=Background)
    parts: Parts = dataclasses.field(default_factory=Parts)
    attention_parts: AttentionParts = dataclasses.field(default_factory=AttentionParts)
    ring_prototypes: RingPrototypes = dataclasses.field(default_factory=RingPrototypes)
    lifecycle: Lifecycle = dataclasses.field(default_factory=Lifecycle)
    similarity: Similarity = dataclasses.field(default_factory=Similarity)
    diagnosis: Diagnosis = dataclasses.field(default_factory=Diagnosis)
    matching: Matching = dataclasses.field(default_factory=Matching)
    sets: Sets = dataclasses.field(default_factory=Sets)
    influence: Influence = dataclasses.field(default_factory=Influence)
    veto: Veto = dataclasses.field(default_factory=Veto)
    stability: Stability = dataclasses.field(default_factory=Stability)
    competition: Competition = dataclasses.field(default_factory=Competition)
    ambiguous: Ambiguous = dataclasses.field(default_factory=Ambiguous)
    provisional: Provisional = dataclasses.field(default_factory=Provisional)
    known_sets: KnownSets = dataclasses.field(default_factory=KnownSets)
    pending: Pending = dataclasses.field(default_factory=Pending)
    cooccurrence: Cooccurrence = dataclasses.field(default_factory=Cooccurrence)
    relations: Relations = dataclasses.field(default_factory=Relations)
    update: Update = dataclasses.field(default_factory=Update)
