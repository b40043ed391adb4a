"""IDF1, HOTA's AssA and recovery inside a JAX program: equal to `evaluate_sequence`.

Shapes are fixed: `T` frames, `N` slots per frame, `O` objects, `L` labels, both numbered from 0; -1
marks an empty slot. Ids from `L` on are false positives and raise `overflow`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.solvers.assignment_in_graph import assign_in_graph

NONE = -1


class GraphScores(NamedTuple):
    """Scores of one run, fractions; recovery is NaN where nothing returned."""

    idf1: Float[Array, ""]
    idp: Float[Array, ""]
    idr: Float[Array, ""]
    hota: Float[Array, ""]
    det_a: Float[Array, ""]
    ass_a: Float[Array, ""]
    recovery: Float[Array, ""]
    hard_recovery: Float[Array, ""]
    opportunities: Int[Array, ""]
    overflow: Bool[Array, ""]  # an id was beyond `num_labels`: scores are a lower bound


def score_labels(
    gt_index: Int[Array, "T N"],
    predicted_id: Int[Array, "T N"],
    firm_id: Int[Array, "T N"] | None = None,
    score: Float[Array, "T N"] | None = None,
    *,
    num_objects: int,
    num_labels: int,
) -> GraphScores:
    """Scores a tracker whose detections are the true masks: a slot is an object and its answer.

    Args:
      gt_index: True object of each detection, -1 where it has none.
      firm_id: What recovery is counted from; `predicted_id` if left out.
      score: Who keeps an id that a frame gives twice: the higher score, then the lower slot.
    """
    firm_id = predicted_id if firm_id is None else firm_id
    score = jnp.zeros(gt_index.shape) if score is None else score
    overflow = jnp.any(predicted_id >= num_labels) | jnp.any(firm_id >= num_labels)
    predicted_id, firm_id = (_keep_first(ids, score) for ids in (predicted_id, firm_id))

    object_hot = _one_hot(gt_index, num_objects)
    common = jnp.einsum("tno,tnl->ol", object_hot, _one_hot(predicted_id, num_labels))
    num_pred = jnp.sum(predicted_id != NONE)
    idf1, idp, idr = _score_identity(common, jnp.sum(object_hot), num_pred)
    lengths = jnp.sum(object_hot, axis=(0, 1))
    label_lengths = jnp.sum(_one_hot(predicted_id, num_labels), axis=(0, 1))
    det_a, ass_a = _score_association(common, lengths, label_lengths, num_pred)

    opportunities, recovered, hard = _count_recovery(
        jnp.any(object_hot > 0, axis=1),
        jnp.max(jnp.where(object_hot > 0, firm_id[:, :, None], NONE), axis=1),
        num_labels,
    )
    total = jnp.where(opportunities > 0, opportunities, jnp.nan)
    return GraphScores(
        idf1,
        idp,
        idr,
        jnp.sqrt(det_a * ass_a),
        det_a,
        ass_a,
        recovered / total,
        hard / total,
        opportunities,
        overflow,
    )


def _one_hot(index: Int[Array, "T N"], size: int) -> Float[Array, "T N size"]:
    return jax.nn.one_hot(index, size, dtype=jnp.float32)  # all zero for -1 and beyond


def _keep_first(ids: Int[Array, "T N"], score: Float[Array, "T N"]) -> Int[Array, "T N"]:
    """Each id once per frame: with the highest score, then the lowest slot."""
    slot = jnp.arange(ids.shape[1])
    higher = score[:, None] > score[:, :, None]
    earlier = (score[:, None] == score[:, :, None]) & (slot[None, :] < slot[:, None])[None]
    taken = jnp.any((ids[:, :, None] == ids[:, None]) & (higher | earlier), axis=2)
    return jnp.where(taken, NONE, ids)


def _score_identity(
    common: Float[Array, "O L"], num_gt: Float[Array, ""], num_pred: Int[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """IDF1, IDP, IDR from the frames that objects and labels share."""
    nothing = jnp.zeros(len(common), jnp.int32)
    column = assign_in_graph(common, common > 0, nothing, nothing.astype(float), jnp.asarray(True))
    right = jnp.sum(jnp.where(column >= 0, _take(common, column), 0.0))
    total = jnp.maximum(1.0, 0.5 * (num_gt + num_pred))
    return right / total, right / jnp.maximum(1.0, num_pred), right / jnp.maximum(1.0, num_gt)


def _score_association(
    pairs: Float[Array, "O L"],
    lengths: Float[Array, "O"],
    label_lengths: Float[Array, "L"],
    num_pred: Int[Array, ""],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """DetA and AssA from the matches of objects and labels."""
    num_matches = jnp.sum(pairs)
    det_a = num_matches / jnp.maximum(1.0, jnp.sum(lengths) + num_pred - num_matches)
    union = jnp.maximum(1.0, lengths[:, None] + label_lengths[None, :] - pairs)
    return det_a, jnp.sum(pairs * (pairs / union)) / jnp.maximum(1.0, num_matches)


def _count_recovery(
    visible: Bool[Array, "T O"], answer: Int[Array, "T O"], num_labels: int
) -> tuple[Int[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """Opportunities, recovered and hard recovered returns, by the one-to-one reference."""
    answer = jnp.where(answer < num_labels, answer, NONE)
    reference = _find_reference(answer, num_labels)
    is_right = (answer == reference[None, :]) & (answer != NONE)

    def look(carry, frame):
        seen_before, was_visible, is_return, recovered, counts = carry
        visible, is_right = frame
        starts = visible & seen_before & ~was_visible
        is_return = jnp.where(visible & ~was_visible, seen_before, is_return)
        recovered = jnp.where(starts, False, recovered)
        newly = visible & is_return & is_right & ~recovered
        counts = counts + jnp.stack(
            [jnp.sum(starts), jnp.sum(newly), jnp.sum(starts & is_right)]
        ).astype(jnp.int32)
        carry = (seen_before | visible, visible, is_return, recovered | newly, counts)
        return carry, None

    nobody = jnp.zeros(visible.shape[1], bool)
    carry = (nobody, nobody, nobody, nobody, jnp.zeros(3, jnp.int32))
    (*_, counts), _ = lax.scan(look, carry, (visible, is_right))
    return counts[0], counts[1], counts[2]


def _find_reference(answer: Int[Array, "T O"], num_labels: int) -> Int[Array, "O"]:
    num_objects = answer.shape[1]
    worth = jnp.sum(jax.nn.one_hot(answer, num_labels, dtype=jnp.float32), axis=0)
    takes_part = jnp.any(worth > 0, axis=1)
    # Objects that were never answered compete with nobody: a group of their own.
    group = jnp.where(takes_part, 0, 1 + jnp.arange(num_objects))
    used = jnp.any(worth > 0, axis=0)
    column = assign_in_graph(
        worth,
        used[None] & takes_part[:, None],
        group.astype(jnp.int32),
        jnp.zeros(num_objects),
        jnp.asarray(False),
    )
    is_common = (column >= 0) & (_take(worth, column) > 0)
    return jnp.where(is_common, column, NONE)


def _take(matrix: Float[Array, "O L"], column: Int[Array, "O"]) -> Float[Array, "O"]:
    return jnp.take_along_axis(matrix, jnp.maximum(column, 0)[:, None], axis=1)[:, 0]
