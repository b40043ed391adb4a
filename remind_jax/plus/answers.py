"""What is reported of each detection: firm answers, doubts, and how probable they are.

Rule: method_plus.md#answers.

Letters: `N` detections, `C` candidates, `K` objects that an undecided detection could be.
"""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import NUM_OPTIONS, Decisions, Outcome, Reason, Status, no_decisions
from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.numerics.row_lookup import look_up_in_rows
from remind_jax.plus import thresholds as th
from remind_jax.plus.decision import Choice
from remind_jax.plus.evidence import Shortlist
from remind_jax.plus.layout import Weighed
from remind_jax.plus.observation import Sightings
from remind_jax.plus.state import Objects, Tracklets
from remind_jax.plus.verdicts import Stage, Verdicts
from remind_jax.static import Static

SMALL = 0.24  # size of a mask below which a new object is small, length
LEAST_BELIEF = 1e-3  # what is believed less, or doubted less, counts as this
# How often answers are right that are believed by so much, and that are doubted by so much.
# The belief is that of the evidence; what it does not know of, it cannot doubt.
OPEN_KNOWN = 0.046, 0.981  # probabilities
OPEN_NEW = 0.19, 0.942
KNOWN = 0.0113, 0.9985
NEW = 0.5615, 0.9811
# What is decided as new and was never whole in view: ticks below which it was not, and what the log
# odds of its belief become.
CUT_MOVES = 1.0
CUT_SLOPE, CUT_LOSS = 1.4, 9.0
# Log odds of looks that contradict an answer before it is decided: those of what it names, and of
# any known object where it is new.
UNLIKE, ALIKE = -2.0, 3.0
LEAST_TRUST = 0.5  # of a tracklet that passed to another thing more likely than not
# Share of a decided belief that is lost if the object moves, and if its class does.
MOVING_LOSS, MOVING_CLASS_LOSS = 0.6, 0.8

# Why a detection became what it became.
_REASONS = {
    Outcome.MATCH: Reason.ASSIGNED,
    Outcome.NEW: Reason.CREATED_NEW,
    Outcome.AMBIGUOUS: Reason.KNOWN_BUT_AMBIGUOUS,
    Outcome.PROVISIONAL_PARENT: Reason.UNCERTAIN_PARENT,
    Outcome.PROVISIONAL_NEW: Reason.UNCERTAIN_NEW,
    Outcome.DROPPED: Reason.INVALID_INPUT,
}


def conclude(
    here: Tracklets,
    objects: Objects,
    is_open: Bool[Array, "N"],
    shortlist: Shortlist,
    weighed: Weighed,
    choice: Choice,
) -> Verdicts:
    """Names the objects of all decisions.

    Args:
      here: Tracklets of the detections, before the decisions.
      objects: Objects, before any is created.
    """

    def id_of(slot: Int[Array, "*any"]) -> Int[Array, "*any"]:
        return objects.id[jnp.maximum(slot, 0)]

    own = jnp.where(here.slot != NO_SLOT, id_of(here.slot), here.id)
    is_known = choice.slot != NO_SLOT
    chosen = shortlist.valid & (shortlist.slot == choice.slot[:, None])
    known = jnp.where(is_known[:, None], chosen, True)
    share = jnp.sum(jnp.where(known, weighed.belief, 0.0), axis=1)
    open_belief = jnp.where(is_known, share, 1.0 - share)
    stage = jnp.where(here.alive, int(Stage.SETTLED), int(Stage.NONE))
    stage = jnp.where(is_open, int(Stage.OPEN), stage)
    return Verdicts(
        tracklet_id=jnp.where(here.alive, here.id, NO_ID),
        answer_id=jnp.where(here.alive, jnp.where(is_known, id_of(choice.slot), own), NO_ID),
        stage=stage.astype(jnp.int32),
        age=jnp.where(here.alive, here.age, 0),
        is_decided=here.alive & (~is_open | choice.recognized | choice.born),
        probability=jnp.clip(jnp.where(is_open, open_belief, here.belief), 0.0, 1.0),
        margin=jnp.where(is_open & jnp.isfinite(choice.margin), choice.margin, 0.0),
        new_odds=choice.private,
        option_id=jnp.where(shortlist.valid, id_of(shortlist.slot), NO_ID),
        option_odds=weighed.odds,
        option_belief=weighed.belief,
        evidence=weighed.evidence,
    )


def report(
    verdicts: Verdicts,
    moves: Float[Array, "N"],
    stays: Float[Array, "N"],
    here: Tracklets,
    present: Bool[Array, "N"],
    sightings: Sightings,
    static: Static,
    t: th.Decision,
) -> Decisions:
    """Fills in what all trackers report.

    An open tracklet gets a firm answer where that is probable enough; a small new object
    must be more so, as most ids of what is never seen again would be theirs. Otherwise the known
    objects that it could be are listed, and whether it is rather a new one. A decided one keeps its
    firm answer until it passed to another thing more likely than not.

    Args:
      moves: How far each answer is an object that moves of its own.
      stays: How far things of its class stay where they are.
      here: Tracklets of the detections, before the decisions.
      present: Detection slots that hold a mask.
    """
    seen = verdicts.tracklet_id != NO_ID
    is_own = verdicts.answer_id == verdicts.tracklet_id
    undecided = seen & ~verdicts.is_decided
    belief_in_answer = believe(verdicts, here)
    calibrated = _calibrate(belief_in_answer, verdicts.is_decided, is_own, moves, stays)
    confidence = jnp.where(seen, calibrated, 0.0)
    passed_on = seen & verdicts.is_decided & (here.trust < LEAST_TRUST)
    belief = verdicts.option_belief
    option_id, option_score = _list_options(verdicts, undecided, passed_on)
    could_be = option_score >= t.possible
    num_close = jnp.sum(could_be, axis=1, dtype=jnp.int32)
    may_be_new = is_own & (1.0 - jnp.sum(belief, axis=1) >= t.possible)
    leans_new = undecided & (may_be_new | (num_close == 0))
    is_small = is_own & (sightings.size < SMALL)
    firm = jnp.where(is_small, t.firm_small, t.firm)
    looks = jnp.where(verdicts.option_id != NO_ID, verdicts.evidence.looks, 0.0)
    is_answer = verdicts.option_id == verdicts.answer_id[:, None]
    against = jnp.where(is_own[:, None], looks > ALIKE, is_answer & (looks < UNLIKE))
    contradicted = jnp.any(against, axis=1)
    doubtful = (undecided & ((confidence < firm) | contradicted)) | passed_on
    is_parent = undecided & (num_close == 1)
    undecided_outcome = jnp.where(
        is_parent, int(Outcome.PROVISIONAL_PARENT), int(Outcome.AMBIGUOUS)
    )
    undecided_outcome = jnp.where(leans_new, int(Outcome.PROVISIONAL_NEW), undecided_outcome)
    firm_outcome = jnp.where(is_own & ~here.named, int(Outcome.NEW), int(Outcome.MATCH))
    outcome = jnp.where(doubtful, undecided_outcome, firm_outcome)
    outcome = jnp.where(seen, outcome, jnp.where(present, int(Outcome.DROPPED), int(Outcome.EMPTY)))
    is_firm = seen & ~doubtful
    reason = jnp.full_like(outcome, int(Reason.NONE))
    for what, why in _REASONS.items():
        reason = jnp.where(outcome == int(what), int(why), reason)
    status = jnp.where(is_firm, int(Status.STRONG), int(Status.AMBIGUOUS))
    status = jnp.where(seen, status, int(Status.NONE)).astype(jnp.int32)
    # The answer first, the rest by falling probability; what it can hardly be is not told.
    is_answer = option_id == verdicts.answer_id[:, None]
    rank = jnp.where(could_be, option_score + 2.0 * is_answer, -1.0)
    _, first = jax.lax.top_k(rank, NUM_OPTIONS)
    shown = doubtful[:, None] & look_up_in_rows(could_be, first)
    firm_id = jnp.where(is_firm, verdicts.answer_id, NO_ID)
    ordered, ranked = jax.lax.top_k(belief, belief.shape[1])
    listed = _shown_candidates(verdicts, ordered, ranked, doubtful, static.num_candidates, t)
    return dataclasses.replace(
        no_decisions(static),
        outcome=outcome.astype(jnp.int32),
        reason=reason.astype(jnp.int32),
        object_id=firm_id,
        pending_id=jnp.where(doubtful, verdicts.tracklet_id, NO_ID),
        score=confidence,
        status=status,
        confidence=confidence,
        best_score=ordered[:, 0],
        second_score=ordered[:, 1],
        option_id=jnp.where(shown, look_up_in_rows(option_id, first), NO_ID),
        option_score=jnp.where(shown, look_up_in_rows(option_score, first), 0.0),
        num_bad_patches=sightings.num_bad_patches,
        **listed,
    )


def believe(verdicts: Verdicts, here: Tracklets) -> Float[Array, "N"]:
    """Probability of each answer, as it is believed from now on.

    Another part of a known object looks like a new one: what is decided as new and was never whole
    in view is believed less.
    """
    is_new = verdicts.is_decided & (verdicts.answer_id == verdicts.tracklet_id)
    is_cut = is_new & (verdicts.stage == int(Stage.OPEN)) & (here.num_moves < CUT_MOVES)
    less = jax.nn.sigmoid(CUT_SLOPE * _log_odds(verdicts.probability) - CUT_LOSS)
    return jnp.where(is_cut, less, verdicts.probability)


def _calibrate(
    probability: Float[Array, "N"],
    is_decided: Bool[Array, "N"],
    is_own: Bool[Array, "N"],
    moves: Float[Array, "N"],
    stays: Float[Array, "N"],
) -> Float[Array, "N"]:
    """How often answers of this kind and belief are right."""

    def by_kind(end: int) -> Float[Array, "N"]:
        decided = jnp.where(is_own, NEW[end], KNOWN[end])
        is_open = jnp.where(is_own, OPEN_NEW[end], OPEN_KNOWN[end])
        return _log_odds(jnp.where(is_decided, decided, is_open))

    low, high = by_kind(0), by_kind(1)
    most = math.log(1.0 / LEAST_BELIEF - 1.0)
    belief = _log_odds(probability) / most
    # Nothing confirms later what was decided of an object that is found elsewhere every time, and
    # others like it come and go where a class moves.
    left = (1.0 - MOVING_LOSS * moves) * (1.0 - MOVING_CLASS_LOSS * (1.0 - stays))
    belief *= jnp.where(is_decided, left, 1.0)
    return jax.nn.sigmoid(low + (high - low) * (belief + 1.0) / 2.0)


def _log_odds(probability: Float[Array, "N"]) -> Float[Array, "N"]:
    clipped = jnp.clip(probability, LEAST_BELIEF, 1.0 - LEAST_BELIEF)
    return jnp.log(clipped / (1.0 - clipped))


def _list_options(
    verdicts: Verdicts,
    undecided: Bool[Array, "N"],
    passed_on: Bool[Array, "N"],
) -> tuple[Int[Array, "N M"], Float[Array, "N M"]]:
    """Known objects with their probabilities; last what was decided, if it is."""
    last = jnp.where(passed_on, verdicts.probability, 0.0)
    ids = jnp.concatenate([verdicts.option_id, verdicts.answer_id[:, None]], axis=1)
    known = jnp.where(undecided[:, None], verdicts.option_belief, 0.0)
    return ids, jnp.clip(jnp.concatenate([known, last[:, None]], axis=1), 0.0, 1.0)


def _shown_candidates(
    verdicts: Verdicts,
    ordered: Float[Array, "N C"],
    ranked: Int[Array, "N C"],
    doubtful: Bool[Array, "N"],
    width: int,
    t: th.Decision,
) -> dict[str, Array]:
    """The most probable candidates, as all trackers show them; of what is in doubt possible ones.

    Args:
      ordered: Probabilities, falling.
      ranked: Which candidates have those.
    """

    def show(values: Array, blank: float) -> Array:
        lacking = max(0, width - values.shape[1])
        return jnp.pad(values[:, :width], ((0, 0), (0, lacking)), constant_values=blank)

    ids = look_up_in_rows(verdicts.option_id, ranked)
    ids = jnp.where(doubtful[:, None] & (ordered < t.possible), NO_ID, ids)
    valid = ids != NO_ID
    return {
        "candidate_id": show(ids, NO_ID),
        "candidate_score": show(ordered, 0.0),
        "candidate_final": show(ordered, 0.0),
        "candidate_eligible": show(valid, False),
        "candidate_plausible": show(valid, False),
    }
