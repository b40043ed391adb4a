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
    Menu,
    Options,
    largest_choice,
    list_options,
    support_by_kernel,
    write_menu,
)
from remind_jax.remind.context.selection import number_sets, rank_choices, select_children
from remind_jax.remind.context.set_score import (
    FrameScale,
    Tally,
    empty_tally,
    score_sets,
    tally_choices,
)
from remind_jax.remind.thresholds.context import Sets
from remind_jax.static import Static


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Rating:
    """What is known of sets, any leading shape."""

    score: Float[Array, "..."]  # [0, 1]
    density: Float[Array, "..."]  # [0, 1]
    maturity: Float[Array, "..."]  # mean over the members, [0, 1)
    tally: Tally

    def pack(self) -> Float[Array, "... F"]:
        """All fields side by side: one array to write, and to pick from."""
        return jnp.stack([leaf.astype(self.score.dtype) for leaf in jax.tree.leaves(self)], axis=-1)

    @classmethod
    def unpack(cls, packed: Float[Array, "... F"]) -> Rating:
        """The fields of what `pack` gives."""
        score, density, maturity, info, support, weight, stability, lead, exclusive = (
            packed[..., field] for field in range(packed.shape[-1])
        )
        tally = Tally(info, support, weight, stability, lead, exclusive > 0)
        return cls(score, density, maturity, tally)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
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
    zero = jnp.zeros((), scalar)
    one = (
        empty_set(min(num, slots), slots, scalar),
        Rating(score=zero, density=zero, maturity=zero, tally=empty_tally(scalar)).pack(),
        jnp.zeros(num, bool),
    )
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

    Args:
      beam: What earlier classes led to.
      classes: The classes in view.
      step: Which of them to take up.
      scale: What the sets are measured against; all but the number of classes.
      view: Memory and detections.
      links: Ties between objects.
      static: Sizes of the search.
      t: Thresholds.
    """
    pool, places = classes.pool[step], classes.detections.shape[1]
    most = min(places, pool.shape[0] - 1)  # no more detections than objects are explained
    menu = write_menu(classes.pool_size[step], classes.num_detections[step], most, static, t)
    scale = dataclasses.replace(scale, num_classes=step + 1)

    def rate(rows: tuple[MemberSet, Array]) -> tuple[Array, Array, Array]:
        sets, rates = rows
        support, has_kernel = support_by_kernel(sets.members, pool, view, links.maturity, static, t)
        options = list_options(support, has_kernel, pool, menu, t)
        tally = Rating.unpack(rates).tally
        rating = _rate_choices(sets, tally, options, menu, scale, links, t)
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
        sets=join_chosen(beam.sets, parent, chosen, largest_choice(menu), num_sets, links),
        rates=rates[parent, count, variant],
        num_sets=num_sets,
        set_of=set_of,
        detections=beam.detections[child.row] | explained,
        valid=child.valid,
    )


def _rate_choices(
    sets: MemberSet,
    tally: Tally,
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
    tree = grow_trees(sets, ranked, largest_choice(menu), links)
    cohesion = rate_cohesion(size, tree, count_links(sets, ranked, links, t), t)
    trust = rate_trust(members_by_choice(sets.members, ranked), size, links.maturity, t)
    grown = tally_choices(tally, options, menu)
    score = score_sets(size, cohesion, trust, grown, scale, t)
    return Rating(score, cohesion.density, trust.maturity, grown)


def _chosen_objects(
    ranked: Int[Array, "W C"], count: Int[Array, "W"], variant: Int[Array, "W"]
) -> Int[Array, "W K"]:
    """The objects of a choice, NO_SLOT behind them."""
    place = jnp.arange(ranked.shape[1] - 1)
    last = jnp.take_along_axis(ranked, jnp.maximum(count - 1 + variant, 0)[:, None], axis=1)
    chosen = jnp.where(place == (count - 1)[:, None], last, ranked[:, :-1])
    return jnp.where(place < count[:, None], chosen, NO_SLOT)
