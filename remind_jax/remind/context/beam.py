"""Partial hypotheses and how they take up one more class (method.md#beam-search).

Letters: `W` beam rows, `N` detections, `O` objects, `K` most detections per class, `C = K + 1`
counts.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import count_before, order_rising
from remind_jax.remind.context.chunks import by_chunks
from remind_jax.remind.context.evidence import FrameView, Links
from remind_jax.remind.context.frame_classes import FrameClasses
from remind_jax.remind.context.growth import (
    choice_mask,
    count_links,
    grow_trees,
    join_chosen,
    members_by_choice,
)
from remind_jax.remind.context.member_sets import MemberSet, empty_set, rate_cohesion, rate_trust
from remind_jax.remind.context.options import (
    VARIANTS,
    Menu,
    Options,
    list_options,
    support_by_kernel,
    write_menu,
)
from remind_jax.remind.context.set_score import FrameScale, Rating, score_sets, tally_choices
from remind_jax.remind.thresholds.context import Sets
from remind_jax.static import Static


@pytree
class Children:
    """The rows of the next beam, by their parent and what they chose."""

    row: Int[Array, "W"]  # parent
    count: Int[Array, "W"]  # detections and objects chosen
    det_variant: Int[Array, "W"]  # 1: the last detection replaced by the next
    variant: Int[Array, "W"]  # 1: the last object replaced by the next
    valid: Bool[Array, "W"]


def rank_choices(
    support: Float[Array, "S C 2"], allowed: Bool[Array, "C 2 2"]
) -> Int[Array, "S choices"]:
    """The choices of every set by falling support of their objects; those that exist first."""
    support = jnp.where(allowed, support[:, :, None, :], -jnp.inf)
    return order_rising([-support.reshape(support.shape[0], -1)])


def select_children(
    score: Float[Array, "S C 2"],
    order: Int[Array, "S choices"],
    allowed: Bool[Array, "C 2 2"],
    set_of: Int[Array, "W"],
    live: Bool[Array, "W"],
    diverse: Bool[Array, ""],
) -> Children:
    """The best children, ordered by score, then row, then support of the choice (`rank_choices`).

    With `diverse`, the best child of each count comes first, the largest count at the front.
    """
    counts = score.shape[1]
    choices = counts * VARIANTS * VARIANTS
    by_index = jnp.where(allowed, score[:, :, None, :], -jnp.inf)
    value = jnp.take_along_axis(by_index.reshape(-1, choices), order, axis=1)
    value = jnp.where(live[:, None], value[set_of], -jnp.inf)
    choice = order[set_of]

    # The first best row of each count, then its first best place there.
    of_count = jnp.max(by_index, axis=(2, 3))[:, ::-1]
    of_count = jnp.where(live[:, None], of_count[set_of], -jnp.inf)
    leading = jnp.argmax(of_count, axis=0)
    top = jnp.max(of_count, axis=0)
    chosen = choice[leading] // VARIANTS**2 == jnp.arange(counts - 1, -1, -1)[:, None]
    place = jnp.argmax(chosen & (value[leading] == top[:, None]), axis=1)
    leader = (leading * choices + place).astype(jnp.int32)
    leads = (top >= 0.0) & diverse
    value, choice = value.reshape(-1), choice.reshape(-1)
    index = jnp.arange(len(value), dtype=jnp.int32)
    is_leader = jnp.any(leads & (index[:, None] == leader), axis=1)
    best, rest = jax.lax.top_k(jnp.where(is_leader, -jnp.inf, value), live.shape[0])
    # Leaders in front, then the rest.
    row, before = jnp.arange(live.shape[0]), count_before(leads)
    num_leads = before[-1] + leads[-1]
    ahead = leads & (before == row[:, None])
    front = jnp.sum(jnp.where(ahead, leader, 0), axis=1, dtype=jnp.int32)
    behind = jnp.maximum(row - num_leads, 0)
    child = jnp.where(row < num_leads, front, rest[behind])
    valid = (row < num_leads) | (best[behind] >= 0.0)
    choice = choice[child].astype(jnp.int32)
    return Children(
        row=child // choices,
        count=choice // VARIANTS**2,
        det_variant=choice // VARIANTS % VARIANTS,
        variant=choice % VARIANTS,
        valid=valid,
    )


def number_sets(
    parent: Int[Array, "W"], child: Children, most: int
) -> tuple[Int[Array, "W"], Int[Array, "W"], Int[Array, ""]]:
    """Numbers the sets: that of each child, a child of each, and how many there are."""
    index = jnp.arange(parent.shape[0], dtype=jnp.int32)
    key = (parent * (most + 1) + child.count) * VARIANTS + child.variant
    same = (key[:, None] == key[None]) & child.valid[:, None] & child.valid[None]
    first = jnp.argmax(same, axis=1)
    leads = child.valid & (first == index)
    number = count_before(leads)
    num_sets = number[-1] + leads[-1]
    origin = jnp.sum(jnp.where(leads & (number == index[:, None]), index, 0), axis=1)
    return jnp.where(child.valid, number[first], 0), origin, num_sets


@pytree
class Beam:
    """Partial hypotheses in the order in which they are expanded.

    Rows that differ only in the detections they explain share one set, and all that follows from
    it: a set can be reached by one sequence of choices of objects only.
    """

    sets: MemberSet  # leading axis W, of which `num_sets` count
    rates: Float[Array, "W F"]  # `rating`, packed
    num_sets: Int[Array, ""]
    set_of: Int[Array, "W"]  # set of each row
    detections: Bool[Array, "W N"]
    valid: Bool[Array, "W"]

    @property
    def rating(self) -> Rating:
        """Of each set."""
        return Rating.unpack(self.rates)


def empty_beam(num: int, slots: int, static: Static) -> Beam:
    """Nothing chosen yet, in the first row; the other rows are free."""
    width, scalar = static.switches.beam_width, static.scalar
    # Sums begin at 0, the product of the information at 1.
    rates = jnp.array([field.name == "info" for field in dataclasses.fields(Rating)], scalar)
    one = empty_set(min(num, slots), slots, scalar), rates, jnp.zeros(num, bool)
    sets, rates, detections = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf, (width, *leaf.shape)), one
    )
    rows = jnp.zeros(width, jnp.int32)
    return Beam(sets, rates, jnp.int32(1), rows, detections, jnp.asarray(np.arange(width) == 0))


def expand_by_class(
    beam: Beam,
    classes: FrameClasses,
    step: Int[Array, ""],
    scale: FrameScale,
    view: FrameView,
    links: Links,
    static: Static,
    t: Sets,
) -> Beam:
    """Lets every row make every choice of one class and keeps the best.

    `scale` has all that sets are measured against but the number of classes.
    """
    pool, places = classes.pool[step], classes.detections.shape[1]
    most = min(places, pool.shape[0] - 1)  # no more detections than objects are explained
    menu = write_menu(classes.pool_size[step], classes.num_detections[step], most, static, t)
    scale = dataclasses.replace(scale, num_classes=step + 1)

    def rate(rows: tuple[MemberSet, Array]) -> tuple[Array, Array, Array]:
        sets, rates = rows
        support, has_kernel = support_by_kernel(sets.members, pool, view, links.maturity, static, t)
        options = list_options(support, has_kernel, pool, menu, t)
        rating = _rate_choices(sets, Rating.unpack(rates), options, menu, scale, links, t)
        return options.ranked, rating.pack(), rank_choices(options.support, menu.allowed)

    ranked, rates, order = by_chunks(rate, (beam.sets, beam.rates), beam.num_sets)
    score = Rating.unpack(rates).score
    diverse = menu.num_detections > 1
    child = select_children(score, order, menu.allowed, beam.set_of, beam.valid, diverse)
    taken = choice_mask(places + 1)[child.count, child.det_variant, :places]
    is_detection = classes.detections[step][:, None] == jnp.arange(beam.detections.shape[1])
    explained = jnp.any(taken[:, :, None] & is_detection[None], axis=1)
    set_of, origin, num_sets = number_sets(beam.set_of[child.row], child, most)
    parent = beam.set_of[child.row][origin]
    count, variant = child.count[origin], child.variant[origin]
    chosen = _chosen_objects(ranked[parent], count, variant)
    return Beam(
        sets=join_chosen(beam.sets, parent, chosen, menu.largest, num_sets, links),
        rates=rates[parent, count, variant],
        num_sets=num_sets,
        set_of=set_of,
        detections=beam.detections[child.row] | explained,
        valid=child.valid,
    )


def _rate_choices(
    sets: MemberSet,
    rating: Rating,
    options: Options,
    menu: Menu,
    scale: FrameScale,
    links: Links,
    t: Sets,
) -> Rating:
    """Rates every set after every choice of objects `[W, K+1, 2]`."""
    ranked = options.ranked
    size = sets.size[:, None, None] + jnp.arange(ranked.shape[1], dtype=jnp.int32)[:, None]
    size = jnp.broadcast_to(size, options.support.shape)
    tree = grow_trees(sets, ranked, menu.largest, links)
    density, connection = rate_cohesion(size, tree, count_links(sets, ranked, links, t), t)
    members = members_by_choice(sets.members, ranked)
    maturity, reliability = rate_trust(members, size, links.maturity, t)
    grown = tally_choices(rating, options, menu)
    grown = dataclasses.replace(grown, density=density, maturity=maturity)
    score = score_sets(size, grown, scale, t) * connection * reliability
    return dataclasses.replace(grown, score=jnp.clip(score, 0.0, 1.0))


def _chosen_objects(
    ranked: Int[Array, "W C"], count: Int[Array, "W"], variant: Int[Array, "W"]
) -> Int[Array, "W K"]:
    """The objects of a choice, NO_SLOT behind them."""
    place = jnp.arange(ranked.shape[1] - 1)
    last = jnp.take_along_axis(ranked, jnp.maximum(count - 1 + variant, 0)[:, None], axis=1)
    chosen = jnp.where(place == (count - 1)[:, None], last, ranked[:, :-1])
    return jnp.where(place < count[:, None], chosen, NO_SLOT)
