"""The classes in view, with their detections and objects (method.md#frame-classes).

Letters: `N` detections, `O` objects, `C` classes in view (at most `N`), `K` detections per class,
`L` objects per class and one empty place.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import pick_best, rank_rising
from remind_jax.numerics.reductions import reduce_together
from remind_jax.remind.context.evidence import FrameView, maturity
from remind_jax.remind.thresholds.context import Sets
from remind_jax.static import Static

_LAST = jnp.iinfo(jnp.int32).max


@pytree
class FrameClasses:
    """Known classes of the frame, those of few objects first; other rows are empty."""

    num: Int[Array, ""]  # classes that have detections and objects, and are searched
    detections: Int[Array, "C K"]  # detection slots, surest first, NO_SLOT behind them
    num_detections: Int[Array, "C"]
    pool: Int[Array, "C L"]  # object slots, latest first, NO_SLOT behind them
    pool_size: Int[Array, "C"]


def group_by_class(view: FrameView, static: Static, t: Sets) -> FrameClasses:
    """Picks the detections and the objects of each class that enter the hypotheses."""
    det_class, det_valid = view.det_class, view.det_valid
    num, slots = det_valid.shape[0], view.exists.shape[0]
    same = (det_class[:, None] == det_class[None]) & det_valid[:, None] & det_valid[None]
    index = np.arange(num, dtype=np.int32)
    first = det_valid & ~jnp.any(same & (index[None] < index[:, None]), axis=1)
    stored = (det_class[:, None] == view.object_class[None]) & view.exists[None]
    pool_size = jnp.minimum(jnp.sum(stored, axis=1, dtype=jnp.int32), static.switches.class_pool)
    known = first & (pool_size > 0)
    _, _, order = jax.lax.sort(
        (jnp.where(known, pool_size, _LAST), det_class, jnp.asarray(index)), num_keys=2
    )

    most, width = min(static.switches.class_detections, num), min(static.switches.class_pool, slots)
    detections = _first_by_rank(
        same[order], rank_rising([-view.det_score, jnp.asarray(-index)]), most
    )
    pool = _first_by_rank(stored[order], _rank_objects(view, t), width)
    pool = jnp.pad(-jnp.sort(-pool, axis=1), ((0, 0), (0, 1)), constant_values=NO_SLOT)
    num_known = jnp.sum(known, dtype=jnp.int32)
    limited = jnp.minimum(num_known, t.max_classes)
    return FrameClasses(
        num=jnp.where(t.max_classes > 0, limited, num_known),
        detections=detections,
        num_detections=jnp.sum(detections != NO_SLOT, axis=1, dtype=jnp.int32),
        pool=pool,
        pool_size=jnp.where(known, pool_size, 0)[order],
    )


def _first_by_rank(
    included: Bool[Array, "C X"], rank: Int[Array, "X"], most: int
) -> Int[Array, "C K"]:
    """The included columns of each row by rising rank, NO_SLOT behind them."""
    # float32 holds these keys exactly and has a fast top_k.
    keys = jnp.broadcast_to(-rank.astype(jnp.float32), included.shape)
    return pick_best(keys, included, most)[0]


def _rank_objects(view: FrameView, t: Sets) -> Int[Array, "O"]:
    """Places in the order in which objects enter the pool of their class (method.md#frame-classes).

    Anchors come first, then what anchors lead one to expect, the likeliest first (ties: by the
    anchor that named it first), then the rest, mature and late objects first.
    """
    anchors, slots = view.anchors, view.exists.shape[0]
    slot = jnp.arange(slots, dtype=jnp.int32)
    link = view.conditional
    link = jnp.where((link >= t.min_link) & anchors[:, None] & (slot[:, None] != slot), link, 0.0)
    best, (_, speaker) = reduce_together(("max", link), ("top", link > 0.0), axis=0)
    expected = best > 0.0
    group = jnp.where(anchors, 0, jnp.where(expected, 1, 2)).astype(jnp.int32)
    value = jnp.where(expected, best, maturity(view.graph.episodes, t))
    value = jnp.where(anchors, 0.0, value)
    named = jnp.where(anchors, 0, jnp.where(expected, speaker, slots - slot))
    return rank_rising([group, -value, named])
