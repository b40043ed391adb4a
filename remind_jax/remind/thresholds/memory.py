"""Thresholds of the memory: what is kept of an object, how it is refreshed, and for how long."""

from __future__ import annotations

from remind_jax.numerics.pytree import pytree
from remind_jax.settings.kinds import Gate, Real, Whole
from remind_jax.settings.record import setting

# Where the original keeps these settings.
_A = "update.appearance_memory"
_B = "update.background_memory"
_P = "update.parts_memory"

# fmt: off


@pytree
class Appearance:
    """Appearance banks (method.md#banks, method.md#appearance-learning)."""

    duplicate: Real = setting(0.92, "work prototype refreshed from this similarity on",
        "similarity", more="more and closer prototypes", symbol="τ_dup", key=f"{_A}.dup_thr")
    stable_duplicate: Real = setting(0.95, "stable prototype refreshed from this similarity on",
        "similarity", more="more and closer stable prototypes", key=f"{_A}.stable_dup_thr")
    merge: Real = setting(0.90, "closest pair of a full work bank merged from here on",
        "similarity", more="fewer merges, more is evicted instead", symbol="τ_merge,int",
        key=f"{_A}.merge_thr")
    stable_merge: Real = setting(0.96, "the same for a full stable bank", "similarity",
        more="fewer merges, more is evicted instead", key=f"{_A}.stable_merge_thr")
    novel: Real = setting(0.78, 'with insert "novel": nothing closer than this is inserted',
        "similarity", more="more views are inserted", key=f"{_A}.novel_thr")
    patches_min: Real = setting(8.0, "effective patches at quality 0", "effective patches",
        more="small views have less quality", key=f"{_A}.quality_min_patches")
    patches_full: Real = setting(24.0, "effective patches at quality 1", "effective patches",
        more="fewer views have full quality", key=f"{_A}.quality_full_patches",
        not_below="patches_min")
    create_quality: Real = setting(0.35, "least quality of an inserted observation", "quality",
        more="fewer views are inserted", key=f"{_A}.create_min_quality")
    refresh_work: Gate = setting(True,
        "off: a work duplicate changes nothing and is never promoted",
        key=f"{_A}.update_nn_on_skip")
    work_quality: Real = setting(0.15, "least quality that changes a work prototype", "quality",
        more="fewer views refresh", key=f"{_A}.work_update_min_quality")
    stable_quality: Real = setting(0.20, "least quality that changes a stable prototype", "quality",
        more="fewer views refresh", key=f"{_A}.stable_update_min_quality")
    promote_hits: Whole = setting(5, "hits that make a work prototype stable; 0: never", "hits",
        more="prototypes are proven longer before they are stable", key=f"{_A}.promote_hits")
    promote_quality: Real = setting(0.55, "least mean quality of a promoted prototype", "quality",
        more="fewer prototypes become stable", key=f"{_A}.promote_min_quality")
    gated_update: Gate = setting(False, "refresh by similarity instead of by quality",
        key=f"{_A}.dup_update.ema_on_dup")
    update_margin: Real = setting(0.02, "gated: no change within this margin above `duplicate`",
        "similarity", more="fewer views change a prototype", key=f"{_A}.dup_update.margin")
    update_rate_min: Real = setting(0.02, "gated: step at the margin", "step",
        more="prototypes follow faster", key=f"{_A}.dup_update.alpha_min")
    update_rate_max: Real = setting(0.08, "gated: step at similarity 1", "step",
        more="prototypes follow faster", key=f"{_A}.dup_update.alpha_max",
        not_below="update_rate_min")
    merge_cap: Whole = setting(10, 'with merge "capped": hits count up to this weight', "hits",
        more="the more proven of two merged prototypes prevails more", key=f"{_A}.count_cap")


@pytree
class Background:
    """Background ring banks (method.md#banks, method.md#background-learning)."""

    enabled: Gate = setting(True, "remember and compare the background",
        decided_by=("memory.background.enabled", "update.background_memory.enabled"))
    duplicate: Real = setting(0.93, "work prototype refreshed from this similarity on",
        "similarity", more="more and closer prototypes", symbol="τ_dup", key=f"{_B}.work_dup_thr")
    stable_duplicate: Real = setting(0.95, "stable prototype refreshed from this similarity on",
        "similarity", more="more and closer stable prototypes", key=f"{_B}.stable_dup_thr")
    merge: Real = setting(0.94, "closest pair of a full work bank merged from here on",
        "similarity", more="fewer merges, more is evicted instead", symbol="τ_merge,int",
        key=f"{_B}.work_merge_thr")
    inner_min_patches: Real = setting(8.0, "ring patches at quality 0", "patches",
        more="small inner rings have less quality", key=f"{_B}.global_inner_min_patches")
    inner_full_patches: Real = setting(20.0, "ring patches at quality 1", "patches",
        more="fewer inner rings have full quality", key=f"{_B}.global_inner_full_patches",
        not_below="inner_min_patches")
    outer_min_patches: Real = setting(12.0, "the same for the outer ring", "patches",
        more="small outer rings have less quality", key=f"{_B}.global_outer_min_patches")
    outer_full_patches: Real = setting(28.0, "the same for the outer ring", "patches",
        more="fewer outer rings have full quality", key=f"{_B}.global_outer_full_patches",
        not_below="outer_min_patches")
    min_mask_quality: Real = setting(0.50, "solidity of the mask at quality 0", "solidity",
        more="ragged masks have less quality", key=f"{_B}.global_min_mask_quality")
    create_quality: Real = setting(0.40, "least quality of an inserted observation", "quality",
        more="fewer views are inserted", key=f"{_B}.global_create_min_quality")
    work_quality: Real = setting(0.20, "least quality that changes a work prototype", "quality",
        more="fewer views refresh", key=f"{_B}.global_work_update_min_quality")
    stable_quality: Real = setting(0.25, "least quality that changes a stable prototype", "quality",
        more="fewer views refresh", key=f"{_B}.global_stable_update_min_quality")
    promote_hits: Whole = setting(5, "hits that make a work prototype stable", "hits",
        more="prototypes are proven longer before they are stable", key=f"{_B}.promote_hits_global")
    promote_quality: Real = setting(0.60, "least mean quality of a promoted prototype", "quality",
        more="fewer prototypes become stable", key=f"{_B}.global_promote_min_quality")
    update_margin: Real = setting(0.02, "no change within this margin above `duplicate`",
        "similarity", more="fewer views change a prototype", key=f"{_B}.dup_update.margin")
    update_rate_min: Real = setting(0.02, "step at the margin", "step",
        more="prototypes follow faster", symbol="α", key=f"{_B}.dup_update.alpha_min")
    update_rate_max: Real = setting(0.10, "step at similarity 1", "step",
        more="prototypes follow faster", key=f"{_B}.dup_update.alpha_max",
        not_below="update_rate_min")
    stable_update: Gate = setting(True, "stable prototypes change at all",
        key=f"{_B}.stable_update",
        theirs={"count_capped": True, "none": False, "off": False, "skip": False})
    stable_margin: Real = setting(0.02,
        "as update_margin, of stable prototypes above `stable_duplicate`", "similarity",
        more="fewer views change a stable prototype", key=f"{_B}.stable_dup_update.margin")
    stable_rate_min: Real = setting(0.01, "step of stable prototypes at that margin", "step",
        more="stable prototypes follow faster", key=f"{_B}.stable_dup_update.alpha_min")
    stable_rate_max: Real = setting(0.05, "step of stable prototypes at similarity 1", "step",
        more="stable prototypes follow faster", key=f"{_B}.stable_dup_update.alpha_max",
        not_below="stable_rate_min")
    merge_cap: Whole = setting(10, "hits count up to this weight when two prototypes merge", "hits",
        more="the more proven of two merged prototypes prevails more", key=f"{_B}.count_cap")


@pytree
class Parts:
    """Part banks (method.md#banks, method.md#part-learning)."""

    duplicate: Real = setting(0.93, "work prototype refreshed from this similarity on",
        "similarity", more="more and closer prototypes", symbol="τ_dup", key=f"{_P}.dup_thr")
    stable_duplicate: Real = setting(0.95, "stable prototype refreshed from this similarity on",
        "similarity", more="more and closer stable prototypes", key=f"{_P}.stable_dup_thr")
    merge: Real = setting(0.92, "closest pair of a full work bank merged from here on",
        "similarity", more="fewer merges, more is evicted instead", symbol="τ_merge,int",
        key=f"{_P}.merge_thr")
    stable_merge: Real = setting(0.96, "the same for a full stable bank", "similarity",
        more="fewer merges, more is evicted instead", key=f"{_P}.stable_merge_thr")
    novel: Real = setting(0.78, 'with insert "novel": nothing closer enters a full bank',
        "similarity", more="more parts are inserted", key=f"{_P}.novel_thr")
    one_to_one: Gate = setting(True, "parts of one detection refresh different prototypes",
        key=f"{_P}.greedy_1to1")
    promote_hits: Whole = setting(5,
        "hits from which a work prototype feeds the stable bank; 0: never", "hits",
        more="prototypes are proven longer before they are stable", key=f"{_P}.promote_hits")
    update_margin: Real = setting(0.02, "no change within this margin above `duplicate`",
        "similarity", more="fewer parts change a prototype", key=f"{_P}.dup_update.margin")
    update_rate_min: Real = setting(0.03, "step at the margin", "step",
        more="prototypes follow faster", symbol="α", key=f"{_P}.dup_update.alpha_min")
    update_rate_max: Real = setting(0.15, "step at similarity 1", "step",
        more="prototypes follow faster", key=f"{_P}.dup_update.alpha_max",
        not_below="update_rate_min")
    merge_cap: Whole = setting(10, "hits count up to this weight when two prototypes merge", "hits",
        more="the more proven of two merged prototypes prevails more", key=f"{_P}.merge.count_cap")


@pytree
class Lifecycle:
    """When objects are confirmed, put aside and forgotten (method.md#lifecycle)."""

    confirm_hits: Whole = setting(2, "sightings that confirm an object", "sightings",
        more="objects are confirmed later", symbol="h_confirm", key="update.confirm_hits")
    max_misses_confirmed: Whole = setting(10, "frames unseen that make it inactive; 0: never",
        "frames", more="objects stay active longer", symbol="m_max",
        key="update.max_misses_confirmed")
    max_misses_tentative: Whole = setting(10,
        "frames unseen that remove an unconfirmed one; 0: never", "frames",
        more="they are forgotten later (static.remove_objects)", key="update.max_misses_tentative")
    max_misses_inactive: Whole = setting(0, "frames unseen that remove an inactive one; 0: never",
        "frames", more="they are forgotten later (static.remove_objects)", symbol="TTL",
        key="update.inactive_ttl")


@pytree
class Update:
    """How much of an observation reaches memory (method.md#update-permit, method.md#first-view)."""

    keep_first: Gate = setting(False, "empty banks take what comes first, whatever its quality")
    gated: Gate = setting(False, "only clear matches change memory freely",
        key="update.robust_updates.enabled")
    ambiguous_rate: Real = setting(0.2, "share of the step after an ambiguous match", "share",
        more="doubtful matches teach more", key="update.robust_updates.safe_alpha_scale")
