"""Which objects belong together here, and what follows for every pair? (paper III-D)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import branch
from remind_jax.remind.context.evidence import FrameView
from remind_jax.remind.context.hypotheses import Hypotheses, find_hypotheses, no_hypotheses
from remind_jax.remind.context.influence import Influence, no_influence, weigh_influence
from remind_jax.remind.context.summary import summarize
from remind_jax.remind.context.veto import Veto, veto_pairs
from remind_jax.remind.thresholds.context import Influence as InfluenceRules
from remind_jax.remind.thresholds.context import Sets
from remind_jax.remind.thresholds.context import Veto as VetoRules
from remind_jax.static import Static


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Reasoning:
    """What the context says about a frame."""

    influence: Influence
    plausible: Bool[Array, "N O"]  # candidates that no veto rules out
    veto: Int[Array, "N O"]  # veto.Veto
    hypotheses: Hypotheses


def reason(
    view: FrameView,
    candidate: Bool[Array, "N O"],
    score: Float[Array, "N O"],
    visual_gate: Float[Array, ""],
    static: Static,
    sets: Sets,
    influence: InfluenceRules,
    veto: VetoRules,
) -> Reasoning:
    """Reads the memory of who was seen with whom, before it learns from this frame.

    Args:
      influence: Thresholds of bonus and penalty; its switch turns everything off.
    """
    num, slots = candidate.shape

    def read_context() -> Reasoning:
        hypotheses = find_hypotheses(view, static, sets)
        context = summarize(hypotheses, view, static, sets, influence)
        weighed = weigh_influence(context, view.exists, influence)
        ruled_out = veto_pairs(
            weighed, view, candidate, score, visual_gate, sets.min_link, static, veto
        )
        return Reasoning(weighed, candidate & (ruled_out == Veto.NONE), ruled_out, hypotheses)

    def leave_out() -> Reasoning:
        return Reasoning(
            influence=no_influence(slots, static.scalar),
            plausible=candidate,
            veto=jnp.full((num, slots), Veto.NONE, jnp.int32),
            hypotheses=no_hypotheses(num, slots, static),
        )

    return branch(influence.enabled, read_context, leave_out)
