"""What is reported of each detection: firm answers, doubts, and how probable they are.

Rule: method_plus.md#answers.

Letters: `N` detections, `C` candidates, `K` objects that an undecided detection could be.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import (
    NUM_OPTIONS,
    Decisions,
    MatchOrigin,
    Outcome,
    Reason,
    Status,
    no_decisions,
)
from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.plus import thresholds as th
from remind_jax.plus.decision import Choice
from remind_jax.plus.evidence import Rows, Shortlist
from remind_jax.plus.state import Objects, Stage, Tracklets, Verdicts
from remind_jax.static import Static


def conclude(
    here: Tracklets,
    objects: Objects,
    rows: Rows,
    shortlist: Shortlist,
    odds: Float[Array, "N C"],
    belief: Float[Array, "N C"],
    parts: Float[Array, "N C 8"],
    choice: Choice,
) -> Verdicts:
    """Names the objects of all decisions.

    Args:
      here: Tracklets of the detections, before the decisions.
      objects: Objects, before any is created or absorbed.
      rows: Which tracklets were open.
      shortlist: Their candidates.
      odds: Evidence of these in the end.
      belief: Probability of these in the end.
      parts: What each kind of evidence has in the log odds.
      choice: What was decided.
    """

    def id_of(slot: Int[Array, "*any"]) -> Int[Array, "*any"]:
        return objects.id[jnp.maximum(slot, 0)]

    own = jnp.where(here.slot != NO_SLOT, id_of(here.slot), here.id)
    is_known = choice.slot != NO_SLOT
    chosen = shortlist.valid & (shortlist.slot == choice.slot[:, None])
    known_belief = jnp.sum(jnp.where(chosen, belief, 0.0), axis=1)
    new_belief = 1.0 - jnp.sum(jnp.where(shortlist.valid, belief, 0.0), axis=1)
    open_belief = jnp.where(is_known, known_belief, new_belief)
    settled = ~rows.young & ~choice.absorbed
    weighed = shortlist.valid & rows.any[:, None]
    stage = jnp.select(
        [rows.young, rows.late, here.alive],
        [int(Stage.OPEN), int(Stage.FRESH), int(Stage.SETTLED)],
        int(Stage.NONE),
    )
    return Verdicts(
        tracklet_id=jnp.where(here.alive, here.id, NO_ID),
        stage=stage.astype(jnp.int32),
        age=jnp.where(here.alive, here.age, 0),
        answer_id=jnp.where(here.alive, jnp.where(is_known, id_of(choice.slot), own), NO_ID),
        is_decided=here.alive & (settled | choice.recognized | choice.born | choice.absorbed),
        probability=jnp.clip(jnp.where(settled, here.belief, open_belief), 0.0, 1.0),
        margin=jnp.where(rows.any & jnp.isfinite(choice.margin), choice.margin, 0.0),
        merged_id=jnp.where(choice.absorbed, id_of(here.slot), NO_ID),
        option_id=jnp.where(weighed, id_of(shortlist.slot), NO_ID),
        option_odds=jnp.where(weighed, odds, 0.0),
        option_belief=jnp.where(weighed, belief, 0.0),
        option_parts=jnp.where(weighed[..., None], parts, 0.0),
        new_odds=choice.private,
    )


def report(
    verdicts: Verdicts,
    belief: Float[Array, "N C"],
    base: Float[Array, "N C"],
    here: Tracklets,
    present: Bool[Array, "N"],
    num_bad_patches: Int[Array, ""],
    static: Static,
    t: th.PlusThresholds,
) -> Decisions:
    """Fills in what all trackers report.

    An open tracklet gets a firm answer where that is more probable than not. Otherwise its options
    are listed: known objects, and its own new id, which it will have if it is none of them.

    Args:
      verdicts: Decisions.
      belief: Probability of each candidate.
      base: Evidence of each candidate without that of the others in view.
      here: Tracklets of the detections, before the decisions.
      present: Detection slots that hold a mask.
      num_bad_patches: Patches that were left out.
      static: Capacities.
      t: When an answer is firm, and how often answers are right.
    """
    seen = verdicts.tracklet_id != NO_ID
    is_own = verdicts.answer_id == verdicts.tracklet_id
    undecided = seen & ~verdicts.is_decided
    confidence = jnp.where(seen, _calibrate(verdicts, is_own, t.confidence), 0.0)
    option_id, option_score = _rank_options(verdicts, belief, undecided)
    could_be = option_score >= t.decision.possible
    doubtful = undecided & (confidence < t.decision.firm)
    alone = jnp.sum(could_be[:, :NUM_OPTIONS], axis=1) <= 1
    undecided_outcome = jnp.where(
        alone & ~is_own, int(Outcome.PROVISIONAL_PARENT), int(Outcome.AMBIGUOUS)
    )
    firm_outcome = jnp.where(is_own & ~here.named, int(Outcome.NEW), int(Outcome.MATCH))
    outcome = jnp.where(doubtful, undecided_outcome, firm_outcome)
    outcome = jnp.where(seen, outcome, jnp.where(present, int(Outcome.DROPPED), int(Outcome.EMPTY)))
    is_firm = seen & ~doubtful
    matched = outcome == int(Outcome.MATCH)
    reason = jnp.select(
        [matched, outcome == int(Outcome.NEW), outcome == int(Outcome.AMBIGUOUS), doubtful],
        [
            int(Reason.ASSIGNED),
            int(Reason.CREATED_NEW),
            int(Reason.KNOWN_BUT_AMBIGUOUS),
            int(Reason.UNCERTAIN_PARENT),
        ],
        jnp.where(outcome == int(Outcome.DROPPED), int(Reason.INVALID_INPUT), int(Reason.NONE)),
    )
    status = jnp.where(is_firm, int(Status.STRONG), int(Status.AMBIGUOUS))
    status = jnp.where(seen, status, int(Status.NONE)).astype(jnp.int32)
    shown = doubtful[:, None] & could_be
    firm_id = jnp.where(is_firm, verdicts.answer_id, NO_ID)
    ranked = jnp.argsort(-belief, axis=1, stable=True)[:, : static.num_candidates]
    listed = _shown_candidates(verdicts, belief, base, ranked, static.num_candidates)
    ordered = -jnp.sort(-jnp.where(verdicts.option_id != NO_ID, belief, 0.0), axis=1)
    decisions = dataclasses.replace(
        no_decisions(static),
        outcome=outcome.astype(jnp.int32),
        reason=reason.astype(jnp.int32),
        object_id=firm_id,
        pending_id=jnp.where(doubtful, verdicts.tracklet_id, NO_ID),
        score=confidence,
        status=status,
        status_final=status,
        confidence=confidence,
        best_score=ordered[:, 0],
        second_score=ordered[:, 1],
        num_close=jnp.sum(could_be, axis=1, dtype=jnp.int32),
        source=jnp.where(matched, int(MatchOrigin.ASSOCIATION), int(MatchOrigin.NONE)).astype(
            jnp.int32
        ),
        assigned_id=jnp.where(is_own, NO_ID, verdicts.answer_id),
        guarded_id=jnp.where(is_own, NO_ID, verdicts.answer_id),
        is_anchor=seen & (here.slot != NO_SLOT),
        option_id=jnp.where(shown, option_id, NO_ID)[:, :NUM_OPTIONS],
        option_score=jnp.where(shown, option_score, 0.0)[:, :NUM_OPTIONS],
        num_bad_patches=num_bad_patches,
        **listed,
    )
    return decisions


def _calibrate(verdicts: Verdicts, is_own: Bool[Array, "N"], t: th.Confidence) -> Float[Array, "N"]:
    """How often answers of this kind and belief are right."""

    def by_kind(known: Array, new: Array, open_known: Array, open_new: Array) -> Array:
        decided = jnp.where(is_own, new, known)
        return jnp.where(verdicts.is_decided, decided, jnp.where(is_own, open_new, open_known))

    low = by_kind(t.known, t.new, t.open_known, t.open_new)
    high = by_kind(t.known_sure, t.new_sure, t.open_known_sure, t.open_new_sure)
    return low + (high - low) * verdicts.probability


def _rank_options(
    verdicts: Verdicts, belief: Float[Array, "N C"], undecided: Bool[Array, "N"]
) -> tuple[Int[Array, "N M"], Float[Array, "N M"]]:
    """Known objects and the own new id: the answer first, the rest by falling probability."""
    known = verdicts.option_id != NO_ID
    new = 1.0 - jnp.sum(jnp.where(known, belief, 0.0), axis=1)
    ids = jnp.concatenate([verdicts.option_id, verdicts.tracklet_id[:, None]], axis=1)
    score = jnp.concatenate([jnp.where(known, belief, 0.0), new[:, None]], axis=1)
    score = jnp.where(undecided[:, None], jnp.clip(score, 0.0, 1.0), 0.0)
    is_answer = ids == verdicts.answer_id[:, None]
    order = jnp.argsort(-(score + 2.0 * is_answer), axis=1, stable=True)
    return jnp.take_along_axis(ids, order, axis=1), jnp.take_along_axis(score, order, axis=1)


def _shown_candidates(
    verdicts: Verdicts,
    belief: Float[Array, "N C"],
    base: Float[Array, "N C"],
    ranked: Int[Array, "N M"],
    width: int,
) -> dict[str, Array]:
    """The most probable candidates, as all trackers show them."""

    def pick(values: Array, blank: float) -> Array:
        taken = jnp.take_along_axis(values, ranked, axis=1)
        lacking = width - taken.shape[1]
        return jnp.pad(taken, ((0, 0), (0, lacking)), constant_values=blank)

    valid = verdicts.option_id != NO_ID
    probability = pick(jnp.where(valid, belief, 0.0), 0.0)
    return {
        "candidate_id": pick(verdicts.option_id, NO_ID),
        "candidate_score": probability,
        "candidate_final": probability,
        "candidate_eligible": pick(valid, False),
        "candidate_plausible": pick(valid, False),
        "candidate_bonus": pick(jnp.where(valid, verdicts.option_odds - base, 0.0), 0.0),
    }
