"""Which sets of remembered objects may be in view? (paper III-D; method.md#hypotheses).

A beam search walks the classes in view, those of few objects first, and lets every partial set
explain some detections of the class by some of its objects. Letters: `H` hypotheses,
`N` detections, `O` objects.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import count_up
from remind_jax.numerics.pytree import pytree
from remind_jax.remind.context.beam import Beam, empty_beam, expand_by_class
from remind_jax.remind.context.evidence import FrameView, join_links
from remind_jax.remind.context.frame_classes import group_by_class
from remind_jax.remind.context.set_score import FrameScale, rate_sizes
from remind_jax.remind.thresholds.context import Sets
from remind_jax.static import Static


@pytree
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


def no_hypotheses(num: int, slots: int, static: Static) -> Hypotheses:
    """The outcome of no search, for `num` detections and object `slots`."""
    count = min(static.switches.num_hypotheses, static.switches.beam_width)
    real = jnp.zeros(count, static.scalar)
    return Hypotheses(
        score=real,
        members=jnp.zeros((count, slots), bool),
        detections=jnp.zeros((count, num), bool),
        coverage=real,
        density=real,
        size=jnp.zeros(count, jnp.int32),
        maturity=real,
        valid=jnp.zeros(count, bool),
    )


def find_hypotheses(view: FrameView, static: Static, t: Sets) -> Hypotheses:
    """The sets of objects that explain the frame best; equal ones keep the order of the search."""
    classes = group_by_class(view, static, t)
    links = join_links(view, jnp.sum(classes.pool_size), static, t)
    total = jnp.sum(view.det_valid, dtype=jnp.int32)
    num, slots = view.det_valid.shape[0], view.exists.shape[0]
    scale = FrameScale(total, jnp.int32(0), rate_sizes(min(num, slots), total, t))

    def expand(step: Array, beam: Beam) -> Beam:
        return expand_by_class(beam, classes, step, scale, view, links, static, t)

    beam = count_up(classes.num, expand, empty_beam(num, slots, static))
    return _best_of_beam(beam, scale, classes.num > 0, static, t)


def _best_of_beam(
    beam: Beam, scale: FrameScale, searched: Bool[Array, ""], static: Static, t: Sets
) -> Hypotheses:
    """The best complete sets, no two the same (method.md#kept-hypotheses)."""
    score, size = beam.rating.score[beam.set_of], beam.sets.size[beam.set_of]
    valid = beam.valid & searched & (score >= t.min_set_score)
    valid = valid & ((scale.num_detections <= 1) | (size >= 2))
    count = min(static.switches.num_hypotheses, static.switches.beam_width)
    best, row = jax.lax.top_k(jnp.where(valid, score, -jnp.inf), count)
    kept = best >= 0.0
    which = beam.set_of[row]
    pick = lambda leaf: jnp.where(kept, leaf[which], 0)  # noqa: E731
    return Hypotheses(
        score=jnp.where(kept, best, 0.0),
        members=beam.sets.members[which] & kept[:, None],
        detections=beam.detections[row] & kept[:, None],
        coverage=pick(scale.by_size[0, beam.sets.size]),
        density=pick(beam.rating.density),
        size=pick(beam.sets.size),
        maturity=pick(beam.rating.maturity),
        valid=kept,
    )
