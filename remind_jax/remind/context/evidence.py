"""What past episodes show of who is seen with whom (paper III-D).

Rules: method.md#conditional-probability, method.md#maturity.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree
from remind_jax.remind.memory.cooccurrence import CooccurrenceGraph, conditional
from remind_jax.remind.perception.description import DescribedFrame
from remind_jax.remind.state import TrackerState
from remind_jax.remind.thresholds.context import Sets
from remind_jax.remind.thresholds.relations import Cooccurrence
from remind_jax.static import Static

ROUNDED_OBJECTS = 160  # up to so many in question, link strengths have float32 precision


@pytree
class FrameView:
    """What the context reads: the memory before the frame, and what is in view."""

    graph: CooccurrenceGraph  # who was seen with whom
    conditional: Float[Array, "O O"]  # P(column in view | row in view), smoothed, [0, 1]
    exists: Bool[Array, "O"]  # object slots in use, ordered by rising id
    object_class: Int[Array, "O"]
    anchors: Bool[Array, "O"]  # objects that are surely in view
    det_class: Int[Array, "N"]  # any whole numbers
    det_score: Float[Array, "N"]  # of the detector
    det_valid: Bool[Array, "N"]  # detections in use


def view_frame(
    state: TrackerState, anchors: Bool[Array, "N O"], seen: DescribedFrame, t: Cooccurrence
) -> FrameView:
    """Gathers what the context reads; all objects in memory count, seen in company or not."""
    objects, graph = state.objects, state.cooccurrence
    num_objects = jnp.sum(objects.exists, dtype=jnp.int32)
    return FrameView(
        graph=graph,
        conditional=conditional(graph, num_objects, t),
        exists=objects.exists,
        object_class=objects.class_id,
        anchors=jnp.any(anchors, axis=0),
        det_class=seen.descriptors.class_id,
        det_score=seen.masks.detector_score,
        det_valid=seen.descriptors.valid,
    )


@pytree
class Links:
    """Ties between objects, both directions joined."""

    maturity: Float[Array, "O"]  # trust in what an object remembers, [0, 1)
    strength: Float[Array, "O O"]  # [0, 1], 0 on the diagonal and, if so ruled, for weak ties
    present: Bool[Array, "O O"]  # pairs seen together at least once and not weakly


def maturity(episodes: Int[Array, "O"], t: Sets) -> Float[Array, "O"]:
    """How much an object has been seen in company (method.md#maturity)."""
    return 1.0 - jnp.exp(-t.maturity_rate * episodes.astype(t.maturity_rate.dtype))


def join_links(view: FrameView, num_in_question: Int[Array, ""], static: Static, t: Sets) -> Links:
    """Joins what two objects remember of each other into one tie (method.md#member-sets).

    `num_in_question` are the objects that any hypothesis of the frame may contain.
    """
    forth, back = view.conditional, view.conditional.T
    joint = jnp.sqrt(forth * back) if static.switches.mutual_links else 0.5 * (forth + back)
    other = ~jnp.eye(joint.shape[0], dtype=bool)
    strong = (jnp.clip(joint, 0.0, 1.0) >= t.min_link) & other
    counts = strong | (other & ~t.drop_weak_links)
    seen = (view.graph.count > 0) | (view.graph.count.T > 0)
    strength = jnp.where(counts, jnp.clip(joint, 0.0, 1.0), 0.0)
    rounded = jax.lax.reduce_precision(strength, exponent_bits=8, mantissa_bits=23)
    return Links(
        maturity=maturity(view.graph.episodes, t),
        strength=jnp.where(num_in_question <= ROUNDED_OBJECTS, rounded, strength),
        present=strong & seen,
    )
