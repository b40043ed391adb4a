"""`Thresholds`: every number that people tune, as one pytree of traced scalars.

A changed value never recompiles; a leaf with a leading axis is a sweep. Values are those of the
published tracker. Paper symbols stand in brackets; `config/reference_keys.py` holds the original's
key of every field. "Effective patches" is the summed coverage of a mask in patches.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from remind_jax.numerics.kinds import Gate, Real, Whole
from remind_jax.remind.thresholds.attention_parts import AttentionParts
from remind_jax.remind.thresholds.context import Influence, Sets, Veto
from remind_jax.remind.thresholds.known_sets import KnownSets
from remind_jax.remind.thresholds.outcome import (
    Ambiguous,
    Competition,
    Pending,
    Provisional,
    Stability,
)
from remind_jax.remind.thresholds.relations import Cooccurrence, Relations
from remind_jax.remind.thresholds.ring_prototypes import RingPrototypes


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Perception:
    """What each detection looks like.

    Rules: method.md#patch-coverage, method.md#object-descriptors, method.md#k-means-parts,
    method.md#rings.
    """

    patch_coverage: Real = 0.0  # a patch belongs to an object if its coverage exceeds this
    global_enabled: Gate = True  # describe and remember the object as a whole
    trimmed_enabled: Gate = True  # and by its typical patches
    trim_keep: Real = 0.50  # share of patches kept by the trimmed descriptor [rho]
    trim_min_patches: Whole = 8  # objects with fewer patches are not trimmed
    count_patches: Gate = True  # off: every object is as dense as can be
    max_counted_patches: Whole = 512  # cap of the patch count that the density divides by
    parts_enabled: Gate = True  # describe parts
    part_min_patches: Whole = 6  # smaller clusters are no parts
    part_min_support: Real = 0.0  # clusters of less summed coverage are no parts
    part_merge: Real = 0.80  # a part closer than this to a stronger one is dropped [tau_merge]
    part_trim_keep: Real = 0.50  # static.part_mean "trimmed": share of patches kept
    part_trim_min_patches: Whole = 8  # parts with fewer patches are not trimmed
    kmeans_parts_kept: Gate = True  # remember and compare parts by k-means
    attention_parts_kept: Gate = True  # remember and compare parts by attention
    rings_enabled: Gate = True  # describe the background around objects
    ring_object_coverage: Real = 0.0  # a patch is object, not background, above this coverage
    ring_border: Whole = 1  # patches left out next to the object
    ring_inner: Whole = 3  # outer edge of the inner ring in patches [r_in]
    ring_outer: Whole = 6  # outer edge of the outer ring in patches [r_out]
    ring_adaptive: Gate = True  # widen rings that hold too few patches
    ring_limit: Whole = 10  # patches; widening stops here, at most static.ring_max_radius
    ring_min_inner: Whole = 12  # patches that the inner ring should hold
    ring_min_outer: Whole = 24  # patches that the outer ring should hold
    ring_nested: Gate = False  # the outer ring contains the inner one


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Appearance:
    """Appearance banks (method.md#banks, method.md#appearance-learning)."""

    duplicate: Real = 0.92  # work prototype refreshed from this similarity on [tau_dup]
    stable_duplicate: Real = 0.95  # stable prototype refreshed from this similarity on
    merge: Real = 0.90  # closest pair of a full work bank merged from here on [tau_merge,int]
    stable_merge: Real = 0.96  # the same for a full stable bank
    novel: Real = 0.78  # with insert "novel": nothing closer than this is inserted
    patches_min: Real = 8.0  # effective patches at quality 0
    patches_full: Real = 24.0  # effective patches at quality 1
    trimmed_base: Real = 0.10  # quality of a trimmed descriptor at quality 0
    create_quality: Real = 0.35  # least quality of an inserted observation
    refresh_work: Gate = True  # off: a work duplicate changes nothing and is never promoted
    work_quality: Real = 0.15  # least quality that changes a work prototype
    stable_quality: Real = 0.20  # least quality that changes a stable prototype
    promote_hits: Whole = 5  # hits that make a work prototype stable; 0: never
    promote_quality: Real = 0.55  # least mean quality of a promoted prototype
    gated_update: Gate = False  # refresh by similarity instead of by quality
    update_margin: Real = 0.02  # gated: no change within this margin above `duplicate`
    update_rate_min: Real = 0.02  # gated: step at the margin
    update_rate_max: Real = 0.08  # gated: step at similarity 1
    merge_cap: Whole = 10  # with merge "capped": hits count up to this weight


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Background:
    """Background ring banks (method.md#banks, method.md#background-learning)."""

    enabled: Gate = True  # remember and compare the background
    duplicate: Real = 0.93  # work prototype refreshed from this similarity on [tau_dup]
    stable_duplicate: Real = 0.95  # stable prototype refreshed from this similarity on
    merge: Real = 0.94  # closest pair of a full work bank merged from here on [tau_merge,int]
    inner_min_patches: Real = 8.0  # ring patches at quality 0
    inner_full_patches: Real = 20.0  # ring patches at quality 1
    outer_min_patches: Real = 12.0  # the same for the outer ring
    outer_full_patches: Real = 28.0  # the same for the outer ring
    min_mask_quality: Real = 0.50  # solidity of the mask at quality 0
    create_quality: Real = 0.40  # least quality of an inserted observation
    work_quality: Real = 0.20  # least quality that changes a work prototype
    stable_quality: Real = 0.25  # least quality that changes a stable prototype
    promote_hits: Whole = 5  # hits that make a work prototype stable
    promote_quality: Real = 0.60  # least mean quality of a promoted prototype
    update_margin: Real = 0.02  # no change within this margin above `duplicate`
    update_rate_min: Real = 0.02  # step at the margin [alpha]
    update_rate_max: Real = 0.10  # step at similarity 1
    stable_update: Gate = True  # stable prototypes change at all
    stable_margin: Real = 0.02  # as update_margin, of stable prototypes above `stable_duplicate`
    stable_rate_min: Real = 0.01  # step of stable prototypes at that margin
    stable_rate_max: Real = 0.05  # step of stable prototypes at similarity 1
    merge_cap: Whole = 10  # hits count up to this weight when two prototypes merge


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Parts:
    """Part banks (method.md#banks, method.md#part-learning)."""

    duplicate: Real = 0.93  # work prototype refreshed from this similarity on [tau_dup]
    stable_duplicate: Real = 0.95  # stable prototype refreshed from this similarity on
    merge: Real = 0.92  # closest pair of a full work bank merged from here on [tau_merge,int]
    stable_merge: Real = 0.96  # the same for a full stable bank
    novel: Real = 0.78  # with insert "novel": nothing closer enters a full bank
    one_to_one: Gate = True  # parts of one detection refresh different prototypes
    promote_hits: Whole = 5  # hits from which a work prototype feeds the stable bank; 0: never
    update_margin: Real = 0.02  # no change within this margin above `duplicate`
    update_rate_min: Real = 0.03  # step at the margin [alpha]
    update_rate_max: Real = 0.15  # step at similarity 1
    merge_cap: Whole = 10  # hits count up to this weight when two prototypes merge


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Lifecycle:
    """When objects are confirmed, put aside and forgotten (method.md#lifecycle)."""

    confirm_hits: Whole = 2  # sightings that confirm an object [h_confirm]
    max_misses_confirmed: Whole = 10  # frames unseen that make it inactive [m_max]; 0: never
    max_misses_tentative: Whole = 10  # frames unseen that remove an unconfirmed one; 0: never
    max_misses_inactive: Whole = 0  # frames unseen that remove an inactive one [TTL]; 0: never


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Similarity:
    """One visual score from the channels (method.md#channel-scores, method.md#visual-score)."""

    object_weight: Real = 0.60  # weight of the appearance [w_obj]
    background_weight: Real = 0.25  # weight of the background rings [w_bg]
    parts_weight: Real = 0.10  # weight of the parts [w_parts]
    ring_prototypes_weight: Real = 0.05  # weight of typical patches of the rings
    renormalize: Gate = True  # divide by the weights of the channels that are present
    inner_share: Real = 0.60  # weight of the inner ring in the background score
    outer_share: Real = 0.40  # weight of the outer ring in it

    quality_enabled: Gate = True  # weigh channels by the quality of the observation
    object_floor: Real = 0.65  # share of the object weight that quality cannot take away
    background_floor: Real = 0.35  # the same for the background weight
    parts_floor: Real = 0.0  # the same for the parts weight
    object_min_patches: Real = 8.0  # effective patches at quality 0
    object_full_patches: Real = 32.0  # effective patches at quality 1
    object_min_density: Real = 0.15  # mean coverage of the patches at weight 0
    object_full_density: Real = 0.60  # mean coverage of the patches at full weight
    parts_disabled_below: Real = 8.0  # effective patches below which parts do not count
    parts_min_patches: Real = 12.0  # effective patches at which parts have quality 0
    parts_full_patches: Real = 32.0  # effective patches at which parts have quality 1
    parts_min_count: Real = 2.0  # number of parts at quality 0
    parts_full_count: Real = 4.0  # number of parts at quality 1
    parts_min_support: Real = 0.15  # share of the object that its parts cover, at quality 0
    parts_full_support: Real = 0.45  # the same at quality 1
    parts_min_density: Real = 0.15  # mean coverage of the patches at which parts have weight 0
    parts_full_density: Real = 0.60  # the same at full weight
    background_min_inner: Real = 8.0  # patches of the inner ring at quality 0
    background_full_inner: Real = 20.0  # patches of the inner ring at quality 1
    background_min_outer: Real = 12.0  # patches of the outer ring at quality 0
    background_full_outer: Real = 32.0  # patches of the outer ring at quality 1
    background_min_mask_quality: Real = 0.50  # solidity of the mask at quality 0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """How clear the evidence of one detection is (method.md#reliable-anchors, method.md#status)."""

    anchor_score: Real = 0.75  # least best score of a reliable anchor
    anchor_margin: Real = 0.08  # least lead of a reliable anchor [delta_confirm]
    enabled: Gate = True  # tell STRONG, AMBIGUOUS and WEAK detections apart
    close: Real = 0.03  # candidates within this distance of the best are close
    strong_score: Real = 0.80  # least best score of STRONG
    strong_gap: Real = 0.08  # least lead of STRONG
    ambiguous_score: Real = 0.75  # least best score of AMBIGUOUS, WEAK below
    confidence_enabled: Gate = True  # rate how sure a decision is; off: confidence 0
    small: Real = 1e-6  # what the confidence does not divide by less than
    temperature: Real = 0.05  # lead that counts clearly in the confidence, as a softness
    temperature_least: Real = 0.05  # replaces a temperature that is too small
    coverage_target: Real = 0.60  # share of the four channels that is enough
    gap_center: Real = 0.10  # lead that counts half, with static.margin "sigmoid"
    gap_scale: Real = 0.05  # softness of that step
    gap_scale_least: Real = 0.05  # replaces a scale that is too small


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Matching:
    """Gates, locks and the joint assignment (method.md#gating, method.md#joint-assignment)."""

    match: Real = 0.75  # least final score of a match [tau_match]
    min_visual: Real = 0.60  # least visual score of a match
    gate_match: Gate = True  # pairs below `match` do not enter the assignment
    gate_min_visual: Gate = True  # pairs below `min_visual` do not enter the assignment
    locks: Gate = True  # clear wins are settled before the assignment
    object_locks: Gate = True  # an object's clear best detection may lock
    detection_locks: Gate = True  # a detection's clear best object may lock
    lock_score: Real = 0.90  # least score of a lock [tau_lock]
    lock_gap: Real = 0.10  # least lead of a lock
    lock_relative_gap: Real = 0.10  # least lead as a share of the score
    dummies: Gate = True  # a detection may stay unassigned at a cost
    dummy_score: Real = 0.05  # score of staying unassigned
    dummy_by_confidence: Gate = True  # uncertain detections give way more easily
    dummy_confidence_gain: Real = 0.20  # what full uncertainty adds to dummy_score
    dummy_cap: Real = 0.72  # largest score of staying unassigned
    one_detection_each: Gate = False  # an object goes to one detection of a frame at most


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Update:
    """How much of a matched observation reaches memory (method.md#update-permit)."""

    gated: Gate = False  # only clear matches change memory freely
    ambiguous_rate: Real = 0.2  # share of the step after an ambiguous match


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Thresholds:
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

    def as_arrays(self, scalar: Any) -> Thresholds:
        """The same values as arrays: floats as `scalar`, whole numbers as int32, gates as bool.

        Strong types keep a threshold from being rounded to the precision of what it is compared
        with, and keep Python numbers and arrays from compiling twice.
        """

        def convert(value: Any) -> jax.Array:
            array = jnp.asarray(value)
            if array.dtype == jnp.bool_:
                return array
            if jnp.issubdtype(array.dtype, jnp.integer):
                return array.astype(jnp.int32)
            return array.astype(scalar)

        return jax.tree.map(convert, self)
