"""Which objects belong together here, and what follows for every pair? (paper III-D)."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pytree import pytree
from remind_jax.remind.context.evidence import FrameView
from remind_jax.remind.context.hypotheses import Hypotheses, find_hypotheses, no_hypotheses
from remind_jax.remind.context.influence import (
    Influence,
    find_supported,
    no_influence,
    weigh_influence,
)
from remind_jax.remind.context.summary import summarize
from remind_jax.remind.context.veto import Veto, veto_pairs
from remind_jax.remind.thresholds import Thresholds
from remind_jax.static import Static


@pytree
class Reasoning:
    """What the context says about a frame."""

    influence: Influence
    plausible: Bool[Array, "N O"]  # candidates that no veto rules out
    supported: Bool[Array, "O"]  # objects that it clearly backs
    veto: Int[Array, "N O"]  # veto.Veto
    hypotheses: Hypotheses


def reason(
    view: FrameView,
    candidate: Bool[Array, "N O"],
    score: Float[Array, "N O"],
    static: Static,
    t: Thresholds,
) -> Reasoning:
    """Reads the memory of who was seen with whom, before it learns from this frame."""
    num, slots = candidate.shape

    def read_context() -> tuple[Influence, Array, Array, Hypotheses]:
        hypotheses = find_hypotheses(view, static, t.sets)
        context = summarize(hypotheses, view, static, t.sets, t.influence)
        weighed = weigh_influence(context, view.exists, t.influence)
        vetoes = veto_pairs(weighed, view, candidate, score, static, t)
        return weighed, candidate & (vetoes == Veto.NONE), vetoes, hypotheses

    def leave_out() -> tuple[Influence, Array, Array, Hypotheses]:
        silent = no_influence(slots, static.scalar)
        vetoes = jnp.full((num, slots), Veto.NONE, jnp.int32)
        return silent, candidate, vetoes, no_hypotheses(num, slots, static)

    influence, plausible, veto, hypotheses = branch(t.influence.enabled, read_context, leave_out)
    return Reasoning(
        influence=influence,
        plausible=plausible,
        supported=find_supported(influence, t),
        veto=veto,
        hypotheses=hypotheses,
    )
