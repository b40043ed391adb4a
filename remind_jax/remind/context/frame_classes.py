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
from remind_jax.numerics.ranks import order_rising
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

    by_score = jnp.lexsort((-index, -view.det_score))
    detections = _first_in_order(same[order], by_score, min(static.switches.class_detections, num))
    by_relevance = _rank_objects(view, t)
    width = min(static.switches.class_pool, slots)
    pool = _first_in_order(stored[order], by_relevance, width)
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


def _first_in_order(
    included: Bool[Array, "C X"], order: Int[Array, "X"], count: int
) -> Int[Array, "C K"]:
    """The first included columns of each row in the given order, NO_SLOT behind them."""
    length = order.shape[0]
    places = jnp.where(included[:, order], (length - jnp.arange(length)).astype(jnp.float32), 0.0)
    found, at = jax.lax.top_k(places, count)
    return jnp.where(found > 0.0, order[at], NO_SLOT).astype(jnp.int32)


def _rank_objects(view: FrameView, t: Sets) -> Int[Array, "O"]:
    """Order in which objects enter the pool of their class (method.md#frame-classes).

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
    return order_rising([group, -value, named])
