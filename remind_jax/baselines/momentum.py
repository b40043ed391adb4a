"""Frame-to-frame association with momentum embeddings: the MASA setting of the paper.

The association of MASA (Li et al. 2024) as the paper runs it (benchmark.md#momentum-baseline):
class-aware, no distance gate, memory over the whole scene, momentum 0.3. Its embeddings are
replaced by the masked means that all methods get. Those have unit length, where MASA's have the
length that its training gave them; `logit_scale` stands for it.

Letters: `N` detection slots, `O` object slots, `D` feature dimension.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.baselines.parts import scene_memory
from remind_jax.baselines.parts.masked_mean import LookedAt, Looks, describe
from remind_jax.baselines.parts.scene_memory import Matching, SceneMemory
from remind_jax.method import Host, Method, Needs, Sweeping
from remind_jax.numerics.constant_arrays import zeros
from remind_jax.numerics.plane import overlap_of
from remind_jax.numerics.pooling import dot, to_unit
from remind_jax.numerics.pytree import pytree
from remind_jax.observation import Masks
from remind_jax.settings.kinds import Real
from remind_jax.settings.record import setting
from remind_jax.static import Static


@pytree
class MomentumThresholds:
    """Numbers of the association; published values but for `logit_scale`."""

    match: Real = setting(0.5, "a match scores more than this", "score")
    match_detector_score: Real = setting(0.01, "least detector score of a match", "score")
    birth_detector_score: Real = setting(0.1, "least detector score of a new object", "score")
    momentum: Real = setting(
        0.3, "share of the new view in the embedding of a matched object", "share"
    )
    logit_scale: Real = setting(
        20.0, "cosines are multiplied by it before both softmaxes", "factor"
    )
    distractor_score: Real = setting(0.5, "weaker detections are dropped", "score")
    distractor_iou: Real = setting(0.3, "if they overlap a stronger one by more", "share")


@pytree
class Embeddings:
    """One embedding per object."""

    vector: Float[Array, "O D"]


def init(static: Static) -> SceneMemory:
    """The empty memory."""
    return scene_memory.empty_memory(
        static, Embeddings(zeros((static.num_objects, static.feature_dim)))
    )


def decide(
    state: SceneMemory, seen: LookedAt, *, static: Static, thresholds: MomentumThresholds
) -> tuple[SceneMemory, None]:
    """Matches by bidirectional softmax and cosine, surest detections first."""
    t, looks, masks = thresholds, seen.looks, seen.masks
    detector_score = jnp.asarray(masks.detector_score, jnp.float32)
    considered = looks.valid & ~_find_distractors(masks, detector_score, t)
    score = _compare(state, looks, considered, t)
    allowed = scene_memory.same_class(state, masks) & considered[:, None]
    may_match = considered & (detector_score > t.match_detector_score)
    column = _take_in_turn(score, allowed & may_match[:, None], detector_score, t.match)
    starts = considered & (detector_score > t.birth_detector_score)

    def learn(known: Embeddings, slot: Array, starts: Array) -> Embeddings:
        old = known.vector.at[slot].get(mode="fill", fill_value=0.0)
        share = jnp.where(starts, 1.0, t.momentum)[:, None]
        new = (1 - share) * old + share * looks.vector
        return Embeddings(known.vector.at[slot].set(new, mode="drop"))

    matching = Matching(score, allowed, column, starts, considered)
    return scene_memory.conclude(state, masks, matching, learn, static, looks.num_bad_patches), None


def _compare(
    state: SceneMemory, looks: Looks, considered: Bool[Array, "N"], t: MomentumThresholds
) -> Float[Array, "N O"]:
    """Mean of the bidirectional softmax and the cosine; classes play no part in the softmax."""
    known = state.looks.vector
    pairs = considered[:, None] & state.objects.exists
    logits = jnp.where(pairs, t.logit_scale * dot(looks.vector, known), -jnp.inf)

    def share(axis: int) -> Float[Array, "N O"]:
        return jnp.where(pairs, jax.nn.softmax(logits, axis=axis, where=pairs), 0.0)

    both = (share(1) + share(0)) / 2
    return jnp.where(pairs, (both + dot(looks.vector, to_unit(known))) / 2, 0.0)


def _find_distractors(
    masks: Masks, detector_score: Float[Array, "N"], t: MomentumThresholds
) -> Bool[Array, "N"]:
    """Weak detections that overlap a stronger one of any class."""
    iou = overlap_of(jnp.asarray(masks.box), jnp.asarray(masks.box))
    position = jnp.arange(len(detector_score))
    is_stronger = detector_score[None] > detector_score[:, None]
    is_stronger |= (detector_score[None] == detector_score[:, None]) & (
        position[None] < position[:, None]
    )
    covered = jnp.any(is_stronger & masks.valid[None] & (iou > t.distractor_iou), axis=1)
    return covered & (detector_score < t.distractor_score)


def _take_in_turn(
    score: Float[Array, "N O"],
    allowed: Bool[Array, "N O"],
    detector_score: Float[Array, "N"],
    match: Real,
) -> Int[Array, "N"]:
    """Each detection, surest first, takes the best object that is left, if it is good enough."""
    order = jnp.argsort(-detector_score, stable=True)

    def take(turn: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        column, left = carry
        row = order[turn]
        best = jnp.argmax(left[row])
        is_taken = left[row, best] > match
        column = column.at[row].set(jnp.where(is_taken, best.astype(jnp.int32), -1))
        gone = is_taken & (jnp.arange(left.shape[1]) == best)
        return column, jnp.where(gone, -jnp.inf, left)

    nobody = jnp.full(len(score), -1, jnp.int32)
    start = (nobody, jnp.where(allowed, score, -jnp.inf))
    return jax.lax.fori_loop(0, len(score), take, start)[0]


METHOD = Method(
    "momentum",
    MomentumThresholds,
    init,
    decide,
    describe,
    Needs(patch_reach=0, reads_closeups=True),
    Host(remove=scene_memory.remove_objects, find_faults=scene_memory.find_faults),
    Sweeping(described_by=()),
    title="momentum (MASA setting)",
)
