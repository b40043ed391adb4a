"""Which sets of remembered objects may be in view? (paper III-D; context notes 7).

A beam search walks the classes in view, those of few objects first, and lets every partial set
explain some detections of the class by some of its objects. Letters: `W` beam rows, `H` hypotheses,
`N` detections, `O` objects, `K` most detections per class, `M` most members of a set.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.config.context_thresholds import Sets
from remind_jax.config.static import Static
from remind_jax.context.evidence import Links, NeighbourEvidence, join_links
from remind_jax.context.frame_classes import FrameClasses, group_by_class
from remind_jax.context.member_sets import (
    NOBODY,
    Cohesion,
    MemberSet,
    add_member,
    empty_set,
    rate_cohesion,
)
from remind_jax.context.options import VARIANTS, Options, list_options, support_by_kernel
from remind_jax.context.set_score import (
    FrameScale,
    Tally,
    empty_tally,
    rate_coverage,
    score_sets,
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Hypotheses:
    """Sets of objects that may be in view, the most believable first."""

    score: Float[Array, "H"]  # [0, 1]; zero-score hypotheses are real
    members: Bool[Array, "H O"]
    detections: Bool[Array, "H N"]  # explained by the members
    coverage: Float[Array, "H"]  # [0, 1]
    density: Float[Array, "H"]  # [0, 1]
    size: Int[Array, "H"]  # members
    maturity: Float[Array, "H"]  # mean over the members, [0, 1)
    valid: Bool[Array, "H"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Beam:
    """Partial hypotheses in the order in which they are expanded."""

    sets: MemberSet  # leading axis W
    tally: Tally
    detections: Bool[Array, "W N"]
    valid: Bool[Array, "W"]


def find_hypotheses(
    evidence: NeighbourEvidence,
    exists: Bool[Array, "O"],
    object_class: Int[Array, "O"],
    anchors: Bool[Array, "O"],
    det_class: Int[Array, "N"],
    det_score: Float[Array, "N"],
    det_valid: Bool[Array, "N"],
    static: Static,
    t: Sets,
) -> Hypotheses:
    """Searches the sets of objects that explain the frame best.

    Args:
      evidence: Who was seen with whom.
      exists: Object slots in use, ordered by rising id.
      object_class: Class of each object.
      anchors: Objects that are surely in view.
      det_class: Class of each detection; any whole numbers.
      det_score: Detector score of each detection.
      det_valid: Detections in use.
      static: Sizes of the search.
      t: Thresholds.

    Returns:
      The hypotheses, best first; equal scores keep the order of the search.
    """
    classes = group_by_class(
        evidence, exists, object_class, anchors, det_class, det_score, det_valid, static, t
    )
    links = join_links(evidence, jnp.sum(classes.pool_size), static, t)
    total = jnp.sum(det_valid, dtype=jnp.int32)

    def expand(step: Array, beam: Beam) -> Beam:
        scale = FrameScale(total, step + 1)
        return _expand_by_class(beam, classes, step, scale, evidence, anchors, links, static, t)

    num, slots = det_valid.shape[0], exists.shape[0]
    beam = jax.lax.fori_loop(0, classes.num, expand, _empty_beam(num, slots, static))
    return _best_of_beam(beam, FrameScale(total, classes.num), links, static, t)


def _empty_beam(num: int, slots: int, static: Static) -> Beam:
    """Nothing chosen yet, in the first row; the other rows are free."""
    one = Beam(
        sets=empty_set(min(num, slots), slots, static.scalar),
        tally=empty_tally(static.scalar),
        detections=jnp.zeros(num, bool),
        valid=jnp.zeros((), bool),
    )
    width = static.beam_width
    rows = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (width, *leaf.shape)), one)
    return dataclasses.replace(rows, valid=jnp.arange(width) == 0)


def _expand_by_class(
    beam: Beam,
    classes: FrameClasses,
    step: Int[Array, ""],
    scale: FrameScale,
    evidence: NeighbourEvidence,
    anchors: Bool[Array, "O"],
    links: Links,
    static: Static,
    t: Sets,
) -> Beam:
    """Lets every row make every choice of one class and keeps the best (notes 7.5)."""
    pool, num_detections = classes.pool[step], classes.num_detections[step]
    support, has_kernel = support_by_kernel(
        beam.sets.members, anchors, pool, evidence, links.maturity, static, t
    )
    most = classes.detections.shape[1]
    options = list_options(
        support, has_kernel, pool, classes.pool_size[step], num_detections, most, static, t
    )
    largest = jnp.minimum(num_detections, classes.pool_size[step])
    cohesion = _rate_choices(beam.sets, options, largest, links, t)
    tally = _tally_choices(beam.tally, options)
    size = beam.sets.size[:, None, None] + jnp.arange(most + 1, dtype=jnp.int32)[:, None]
    score = score_sets(size, cohesion, tally, scale, t)
    row, count, det_variant, variant, valid = _select(
        score, options, beam.valid, num_detections > 1
    )

    place = jnp.arange(most)
    taken = _chosen_places(place, count, det_variant)
    is_detection = classes.detections[step][:, None] == jnp.arange(beam.detections.shape[1])
    explained = jnp.any(taken[:, :, None] & is_detection[None], axis=1)
    chosen = options.ranked[row]
    last = jnp.take_along_axis(chosen, jnp.maximum(count - 1 + variant, 0)[:, None], axis=1)
    chosen = jnp.where(place == (count - 1)[:, None], last, chosen[:, :most])
    chosen = jnp.where(place < count[:, None], chosen, NOBODY)
    sets = jax.tree.map(lambda leaf: leaf[row], beam.sets)
    return Beam(
        sets=_add_members(sets, chosen, largest, links),
        tally=jax.tree.map(lambda leaf: leaf[row, count, variant], tally),
        detections=beam.detections[row] | explained,
        valid=valid,
    )


def _chosen_places(
    place: Int[Array, "K"], count: Int[Array, "W"], variant: Int[Array, "W"]
) -> Bool[Array, "W K"]:
    """The first `count` places, the last of them moved on by `variant`."""
    before = place < (count - 1)[:, None]
    return (before | (place == (count - 1 + variant)[:, None])) & (count > 0)[:, None]


def _rate_choices(
    sets: MemberSet, options: Options, largest: Int[Array, ""], links: Links, t: Sets
) -> Cohesion:
    """Cohesion of every row with every choice of objects `[W, K+1, 2]`.

    The choices of a row grow by one object at a time: each count adds one to the best choice of
    the count before, or the one after it.
    """
    grow = jax.vmap(jax.vmap(add_member, (0, 0, None)), (None, 0, None))
    rate = jax.vmap(jax.vmap(rate_cohesion, (0, None, None)), (0, None, None))
    nothing = rate(jax.tree.map(lambda leaf: leaf[None], sets), links, t)
    length = options.ranked.shape[1]
    table = jax.tree.map(lambda leaf: jnp.repeat(leaf[None], VARIANTS, axis=1), nothing)
    table = jax.tree.map(lambda leaf: jnp.repeat(leaf, length, axis=0), table)

    def step(count: Array, carry: tuple[MemberSet, Cohesion]) -> tuple[MemberSet, Cohesion]:
        best, table = carry
        newcomers = jax.lax.dynamic_slice_in_dim(options.ranked, count - 1, VARIANTS, axis=1)
        grown = grow(best, newcomers.T, links)
        rated = rate(grown, links, t)
        table = jax.tree.map(lambda all_, new: all_.at[count].set(new), table, rated)
        return jax.tree.map(lambda leaf: leaf[0], grown), table

    _, table = jax.lax.fori_loop(1, largest + 1, step, (sets, table))
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 2, 0), table)


def _tally_choices(tally: Tally, options: Options) -> Tally:
    """The tally of every row after every choice of objects `[W, K+1, 2]`."""
    row = lambda leaf: leaf[:, None, None]  # noqa: E731
    count = jnp.arange(options.info.shape[0])
    some = (count > 0)[:, None]
    scalar = options.info.dtype
    lead = count.astype(scalar) * options.exclusivity
    shape = options.support.shape
    return Tally(
        info=jnp.broadcast_to(row(tally.info) * options.info[:, None], shape),
        support_sum=row(tally.support_sum)
        + row(options.target) * jnp.clip(options.support, 0.0, 1.0),
        support_weight=jnp.broadcast_to(row(tally.support_weight + options.target), shape),
        stability_sum=jnp.broadcast_to(
            row(tally.stability_sum) + jnp.where(some, row(options.stability), 0.0), shape
        ),
        exclusivity_sum=jnp.broadcast_to(row(tally.exclusivity_sum) + lead[..., None], shape),
        exclusive=jnp.broadcast_to(row(tally.exclusive) | options.exclusive[..., None], shape),
    )


def _select(
    score: Float[Array, "W K+1 2"],
    options: Options,
    live: Bool[Array, "W"],
    diverse: Bool[Array, ""],
) -> tuple[Array, Array, Array, Array, Array]:
    """The best children, ordered by score, then row, then support of the choice (notes 7.5).

    With `diverse`, the best child of each count comes first, the largest count at the front.

    Returns:
      For each row of the next beam: parent row, count, detection variant, object variant, validity.
    """
    width, counts, _ = score.shape
    choices = counts * VARIANTS * VARIANTS
    allowed = options.allowed.reshape(-1)
    expand = lambda leaf: jnp.broadcast_to(  # noqa: E731
        leaf[:, :, None, :], (width, counts, VARIANTS, VARIANTS)
    ).reshape(width, choices)
    order = jnp.argsort(jnp.where(allowed, -expand(options.support), jnp.inf), axis=1, stable=True)
    value = jnp.where(allowed & live[:, None], expand(score), -jnp.inf)
    value = jnp.take_along_axis(value, order, axis=1).reshape(-1)
    count = order.reshape(-1) // VARIANTS**2

    each = jnp.where(count == jnp.arange(counts - 1, -1, -1)[:, None], value, -jnp.inf)
    leader = jnp.argmax(each, axis=1)
    leads = (jnp.max(each, axis=1) >= 0.0) & diverse
    value = value.at[jnp.where(leads, leader, value.shape[0])].set(-jnp.inf, mode="drop")
    best, rest = jax.lax.top_k(value, min(width, value.shape[0]))
    child = jnp.concatenate([leader, rest]).astype(jnp.int32)
    valid = jnp.concatenate([leads, best >= 0.0])
    first = jnp.argsort(~valid, stable=True)[:width]
    child, valid = child[first], valid[first]
    row = child // choices
    choice = order.reshape(-1)[child]
    return (
        row,
        choice // VARIANTS**2,
        choice // VARIANTS % VARIANTS,
        choice % VARIANTS,
        valid,
    )


def _add_members(
    sets: MemberSet, chosen: Int[Array, "W K"], largest: Int[Array, ""], links: Links
) -> MemberSet:
    """Adds to each set the objects chosen for it, one column after the other."""
    add = jax.vmap(add_member, (0, 0, None))
    return jax.lax.fori_loop(
        0, largest, lambda place, grown: add(grown, chosen[:, place], links), sets
    )


def _best_of_beam(
    beam: Beam, scale: FrameScale, links: Links, static: Static, t: Sets
) -> Hypotheses:
    """The best complete sets (notes 7.7).

    No two rows agree in members and detections: choices within a class differ, and what a class
    can choose from depends on earlier choices only.
    """
    size = beam.sets.size
    cohesion = jax.vmap(rate_cohesion, (0, None, None))(beam.sets, links, t)
    score = score_sets(size, cohesion, beam.tally, scale, t)
    valid = beam.valid & (scale.num_classes > 0) & (score >= t.min_set_score)
    valid = valid & ((scale.num_detections <= 1) | (size >= 2))
    count = min(static.num_hypotheses, static.beam_width)
    best, row = jax.lax.top_k(jnp.where(valid, score, -jnp.inf), count)
    kept = best >= 0.0
    pick = lambda leaf: jnp.where(kept, leaf[row], 0)  # noqa: E731
    return Hypotheses(
        score=pick(score),
        members=beam.sets.members[row] & kept[:, None],
        detections=beam.detections[row] & kept[:, None],
        coverage=pick(rate_coverage(size, scale.num_detections, t)),
        density=jnp.where(size[row] >= 2, pick(cohesion.density), 0.0),
        size=pick(size),
        maturity=pick(cohesion.maturity),
        valid=kept,
    )
