"""Known or new, now or later: the joint decision of all open tracklets (method_plus.md#decision).

Letters: `N` detections, `O` object slots, `C` candidates. Evidence is in log odds.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import pytree
from remind_jax.plus import clock
from remind_jax.plus import thresholds as th
from remind_jax.plus.evidence import Shortlist
from remind_jax.plus.slots import NO_ROW, rows_of
from remind_jax.plus.state import Objects, Scene, Tracklets
from remind_jax.plus.static import CLASS_ROWS
from remind_jax.solvers.assignment_in_graph import assign_in_graph

# The running share of new things.
NEWNESS_RATE = 0.2  # share that one decision changes
LEAST_NEWNESS = 0.1  # least share that is assumed, of new things and of known ones
_ROUNDS = 5  # in which it settles
# An answer that leads the next one by less, in log odds, waits so many times as long.
CLEAR_LEAD = 1.25
HESITATION = 2.0


@pytree
class Choice:
    """What was decided about the rows of a frame."""

    slot: Int[Array, "N"]  # object that the row is best taken for, NO_SLOT: its own or a new one
    margin: Float[Array, "N"]  # log odds to its next best answer
    private: Float[Array, "N"]  # log odds of being no known object
    cosine: Float[Array, "N"]  # of looks, to the chosen object
    recognized: Bool[Array, "N"]  # open rows that are a known object from now on
    born: Bool[Array, "N"]  # open rows that are a new object from now on


def decide(
    shortlist: Shortlist,
    odds: Float[Array, "N C"],
    is_open: Bool[Array, "N"],
    here: Tracklets,
    stays: Float[Array, "N"],
    scene: Scene,
    num_objects: int,
    t: th.Decision,
) -> Choice:
    """One assignment of all rows to objects, each with a private column for "no known object".

    `stays`: how far things of its class stay where they are (`own_movement.staying_of_class`).
    """
    odds = jnp.where(shortlist.valid, odds, -jnp.inf)
    new = expect_new(odds, is_open, here.class_id, stays, scene, t)
    # A new identity that is withdrawn later is one too many, so in doubt an early answer is known.
    enough = here.duration >= t.commit_age - clock.SLACK
    tentative = t.tentative + t.tentative_border * here.touched
    private = new - jnp.where(enough, 0.0, tentative)

    is_at = shortlist.slot[..., None] == jnp.arange(num_objects)
    score = jnp.max(jnp.where(is_at, odds[..., None], -jnp.inf), axis=1)
    slot = assign_in_graph(
        score, score > -jnp.inf, jnp.zeros_like(here.slot), private, jnp.array(True)
    )
    chosen = shortlist.valid & (shortlist.slot == slot[:, None])
    of_chosen = jnp.where(chosen, odds, -jnp.inf)
    of_others = jnp.where(chosen, -jnp.inf, odds)
    cosines = jnp.where(chosen, shortlist.cosine, -1.0)
    best, best_other, cosine = jnp.max(jnp.stack([of_chosen, of_others, cosines]), axis=2)
    is_known = best > -jnp.inf
    own = jnp.where(is_known, best, private)
    margin = own - jnp.where(is_known, jnp.maximum(best_other, private), best_other)

    early = is_known & (here.age >= t.early_age) & (margin > t.early_margin)
    # What waits to resume is soon known to have gone on elsewhere, or to be gone.
    waited = here.duration >= HESITATION * t.commit_age - clock.SLACK
    waited &= here.age > clock.MISSED_TICKS
    but_held = jnp.where(shortlist.evidence.held < 0, odds - shortlist.evidence.held, -jnp.inf)
    settled = is_known | (jnp.max(but_held, axis=1) <= private)
    commits = is_open & ((enough & settled & (margin > CLEAR_LEAD)) | waited | early)
    return Choice(
        slot=jnp.where(is_known, slot, NO_SLOT),
        margin=margin,
        private=private,
        cosine=cosine,
        recognized=commits & is_known,
        born=commits & ~is_known,
    )


def expect_new(
    odds: Float[Array, "N C"],
    is_open: Bool[Array, "N"],
    class_id: Int[Array, "N"],
    stays: Float[Array, "N"],
    scene: Scene,
    t: th.Decision,
) -> Float[Array, "N"]:
    """Log odds of a new object: how often things were new lately, and how new those in view look.

    Rule: method_plus.md#novelty.

    What comes into view together is mostly new or mostly known; the share is that at which the
    open tracklets agree with it. What is known of a class speaks before what is known of all.
    Things that move come one by one and not with the camera: what came last says less of them.
    """
    known = jax.nn.logsumexp(odds, axis=1)
    row = class_row(class_id)
    of_class = scene.newness_known[row]
    usual = scene.newness[0] + of_class * (scene.newness[row] - scene.newness[0])

    def prior(share: Array) -> Array:
        share = jnp.clip(share, LEAST_NEWNESS, 1.0 - LEAST_NEWNESS)
        return t.new + t.familiarity * stays * jnp.log(share / (1.0 - share))

    def agree(_: Array, share: Array) -> Array:
        new = jnp.where(is_open, jax.nn.sigmoid(prior(share) - known), 0.0)
        weight = t.familiarity_open * NEWNESS_RATE
        return (usual + weight * jnp.sum(new)) / (1.0 + weight * jnp.sum(is_open))

    return prior(jax.lax.fori_loop(0, _ROUNDS, agree, usual))


def class_row(class_id: Int[Array, "N"]) -> Int[Array, "N"]:
    """Rows of classes in what the scene knows class by class."""
    return 1 + jnp.maximum(class_id, 0) % CLASS_ROWS


def learn_newness(
    scene: Scene,
    objects: Objects,
    choice: Choice,
    class_id: Int[Array, "N"],
    shortlist: Shortlist,
) -> tuple[Scene, Objects]:
    """Follows how often open rows turn out to be new, of all and class by class.

    The same object recognized again and again tells less each time: what flickers before a still
    camera says nothing about newcomers. Nor does a new object where nothing known could be it.
    """
    visits = objects.visits[jnp.maximum(choice.slot, 0)]
    names = jnp.where(shortlist.valid, jnp.exp(shortlist.evidence.class_name), 0.0)
    had_choice = jnp.minimum(jnp.sum(names, axis=1), 1.0)
    weight = jnp.where(choice.recognized, 1.0 / jnp.maximum(visits, 1), choice.born * had_choice)
    rows = jnp.arange(len(scene.newness))[:, None]
    counts = ((rows == 0) | (rows == class_row(class_id))) * NEWNESS_RATE * weight
    left = jnp.prod(1.0 - counts, axis=1)
    share = jnp.sum(counts * choice.born, axis=1) / jnp.maximum(jnp.sum(counts, axis=1), 1e-6)
    row = rows_of(choice.slot, choice.recognized, len(objects.id))
    return (
        dataclasses.replace(
            scene,
            newness=share + left * (scene.newness - share),
            newness_known=1.0 - left * (1.0 - scene.newness_known),
        ),
        dataclasses.replace(objects, visits=objects.visits + (row != NO_ROW)),
    )
