"""Two detections that claim one object: a birth beside its parent, and an identity given twice.

Rules: method.md#competition, method.md#one-detection-each.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Reason
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.ranks import largest
from remind_jax.numerics.reductions import pick_in_rows, reduce_together
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.memory.objects import Lifecycle, Objects
from remind_jax.remind.undecided.provisional_commit import reserve_ids
from remind_jax.remind.undecided.temporal import SUPPORTED, PairTable, rank, temporal_score


def withdraw_second_claims(
    table: PairTable, slot: Int[Array, "N"], score: Float[Array, "N"]
) -> Undecided:
    """Finds detections whose object another detection holds with a better score.

    They become ambiguous between that object and their other plausible candidates. Among equals
    the first detection keeps the object.
    """
    (num, width), t = table.plausible.shape, table.thresholds
    first = jnp.arange(num)
    rival = (slot[:, None] == slot[None]) & (slot >= 0)[:, None]
    better = score[None] > score[:, None]
    better = better | ((score[None] == score[:, None]) & (first[None] < first[:, None]))
    loses = jnp.any(rival & better, axis=1) & t.matching.one_detection_each

    claimed = slot[:, None] == jnp.arange(width)
    others = table.plausible & ~claimed
    slots, scores = rank(temporal_score(table, others), others, t.ambiguous.max_candidates - 1)
    return Undecided(
        present=loses,
        slot=jnp.concatenate([slot[:, None], slots[:, :-1]], axis=1),
        score=jnp.concatenate([score[:, None], scores[:, :-1]], axis=1),
        best=jnp.where(slot == NO_SLOT, 0.0, jnp.maximum(score, scores[:, 0])),
        reason=jnp.full(num, Reason.KNOWN_BUT_HELD_BY_BETTER_MATCH, jnp.int32),
    )


def find_competitions(
    table: PairTable,
    objects: Objects,
    slot: Int[Array, "N"],
    creates: Bool[Array, "N"],
    next_id: Int[Array, ""],
) -> tuple[Undecided, Int[Array, "N"]]:
    """Finds new detections that score nearly as a matched detection does on its object.

    Also gives the id of the object that a detection founds, -1 none (method.md#provisional-commit).
    """
    (num, width), t = table.pairs.eligible.shape, table.thresholds.competition
    known = table.pairs.score_known
    holds = slot[:, None] == jnp.arange(width)
    held = jnp.any(holds, axis=0)
    open_parents = table.comparison.candidate & held[None]
    (_, parent), has_parent = reduce_together(
        ("top", jnp.where(open_parents, known, -jnp.inf)), ("any", open_parents), axis=1
    )
    has_parent = has_parent & creates & t.enabled
    row = jnp.arange(num)
    holder = jnp.argmax(slot[None] == parent[:, None], axis=1)

    mine, plausible, eligible = pick_in_rows(parent, known, table.plausible, table.pairs.eligible)
    lifecycle = objects.lifecycle[parent]
    young = (objects.age[parent] <= t.max_parent_age) | ~t.young_only
    is_confirmed = lifecycle == Lifecycle.CONFIRMED
    fit = jnp.where(is_confirmed, t.confirmed_parents, (lifecycle <= Lifecycle.TENTATIVE) & young)
    least = jnp.where(is_confirmed, t.confirmed_min_score, t.min_score)
    widest = jnp.where(is_confirmed, t.confirmed_max_gap, t.max_gap)
    blocked = plausible & ~eligible
    least = jnp.where(blocked, jnp.minimum(least, t.min_score), least)
    widest = jnp.where(blocked, jnp.maximum(widest, t.max_gap), widest)
    theirs = known[holder, parent]
    ok = has_parent & fit & (mine >= least) & (theirs >= least)
    ok = ok & (jnp.abs(theirs - mine) <= widest)

    # Where both know of another supported candidate that is good enough, nothing competes.
    rival_score = jnp.maximum(known, table.temporal[SUPPORTED])
    both = jnp.stack([row, holder])
    among = table.supported[both]
    others = among & (parent[:, None] != jnp.arange(width)) & (rival_score[both] >= least[:, None])
    sets = jnp.stack([table.plausible[both], among, others])
    num_plausible, num_supported, num_others = jnp.sum(sets, axis=3)
    has_rival = (num_plausible >= 2) & (num_supported >= 2) & (num_others >= 1)
    ok = ok & ~jnp.any(has_rival & table.supported[both, parent], axis=0)
    same = ok & (parent == parent[:, None])
    (_, best), num_same = reduce_together(
        ("top", jnp.where(same, mine, -jnp.inf)), ("sum", same), axis=1
    )
    seed = ok & (best == row) & ~((num_same > 1) & t.single_create)

    # The founding detection and the one that holds the parent share the entry.
    founder = seed & ((holder == row[:, None]) | (row == row[:, None]))
    present, source = largest(founder)
    score = jnp.where(present, jnp.maximum(mine, theirs)[source], 0.0)
    pair = [jnp.where(present, named, NO_SLOT) for named in (parent[source], width + source)]
    entries = Undecided(
        present=present,
        slot=jnp.stack([*pair, jnp.full(num, NO_SLOT)], axis=1).astype(jnp.int32),
        score=jnp.stack([score, score, jnp.zeros_like(score)], axis=1),
        best=score,
        reason=jnp.full(num, Reason.KNOWN_AND_COMMITTED_NEW_COMPETITION, jnp.int32),
    )
    return entries, reserve_ids(seed, parent, creates, next_id)
