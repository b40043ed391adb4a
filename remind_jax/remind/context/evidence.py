"""What past episodes tell about who is seen with whom (paper III-D).

Rules: method.md#conditional-probability, method.md#maturity.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.remind.memory.cooccurrence import CooccurrenceGraph, conditional
from remind_jax.remind.thresholds.context import Sets
from remind_jax.remind.thresholds.relations import Cooccurrence
from remind_jax.static import Static

ROUNDED_OBJECTS = 160  # up to so many in question, link strengths have float32 precision


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class NeighbourEvidence:
    """The co-occurrence graph as the context reads it; rows are the objects that remember."""

    conditional: Float[Array, "O O"]  # P(column in view | row in view), smoothed, [0, 1]
    count: Int[Array, "O O"]  # common episodes in the row's account; 0: no edge
    episodes: Int[Array, "O"]  # episodes of each object
    weight: Float[Array, "O O"]  # decayed count, first sort key of a neighbour list
    last_seen: Int[Array, "O O"]  # frame of the last common episode, second sort key
    order: Int[Array, "O O"]  # position of the edge in its list, third sort key, ascending


def neighbour_evidence(
    graph: CooccurrenceGraph, exists: Bool[Array, "O"], t: Cooccurrence
) -> NeighbourEvidence:
    """The graph as the context reads it; all objects in memory count, seen in company or not."""
    num_objects = jnp.sum(exists, dtype=jnp.int32)
    return NeighbourEvidence(
        conditional=conditional(graph, num_objects, t),
        count=graph.count,
        episodes=graph.episodes,
        weight=graph.weight,
        last_seen=graph.edge_time,
        order=graph.edge_order,
    )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Links:
    """Ties between objects, both directions joined."""

    maturity: Float[Array, "O"]  # trust in an object's account, [0, 1)
    strength: Float[Array, "O O"]  # [0, 1], 0 on the diagonal and, if so ruled, for weak ties
    present: Bool[Array, "O O"]  # pairs seen together at least once and not weakly


def maturity(episodes: Int[Array, "O"], t: Sets) -> Float[Array, "O"]:
    """How much an object has been seen in company (method.md#maturity)."""
    return 1.0 - jnp.exp(-t.maturity_rate * episodes.astype(t.maturity_rate.dtype))


def join_links(
    evidence: NeighbourEvidence, num_in_question: Int[Array, ""], static: Static, t: Sets
) -> Links:
    """Joins what two objects remember of each other into one tie (method.md#member-sets).

    Args:
      evidence: Both accounts.
      num_in_question: Objects that any hypothesis of the frame may contain.
      static: Whether the joint strength is the geometric or the arithmetic mean.
      t: Thresholds.
    """
    forth, back = evidence.conditional, evidence.conditional.T
    joint = jnp.sqrt(forth * back) if static.mutual_links else 0.5 * (forth + back)
    other = ~jnp.eye(joint.shape[0], dtype=bool)
    strong = (jnp.clip(joint, 0.0, 1.0) >= t.min_link) & other
    counts = strong | (other & ~t.drop_weak_links)
    seen = (evidence.count > 0) | (evidence.count.T > 0)
    strength = jnp.where(counts, jnp.clip(joint, 0.0, 1.0), 0.0)
    rounded = jax.lax.reduce_precision(strength, exponent_bits=8, mantissa_bits=23)
    return Links(
        maturity=maturity(evidence.episodes, t),
        strength=jnp.where(num_in_question <= ROUNDED_OBJECTS, rounded, strength),
        present=strong & seen,
    )
