"""What a class name says: a detector may call one thing by several (method_plus.md#class-names).

Letters: `N` detections, `L` rows of classes; classes beyond share rows. Evidence is in log odds.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.plus import thresholds as th
from remind_jax.plus.state import Scene
from remind_jax.plus.static import NAME_ROWS

ASSUMED_SAMPLES = 20.0  # detections that what is assumed of names counts for
LEAST_SEEN = 0.05  # log odds beyond what is assumed: more than rounding makes of it


def confusion_odds(scene: Scene, t: th.Names) -> Float[Array, "L L"]:
    """Log odds, 0 at most, that one thing has both names, by rows of classes.

    By how often tracklets went on under another name, and by what is assumed of names never seen.
    """
    counts = scene.names + scene.names.T
    total = jnp.sum(counts, axis=1) + ASSUMED_SAMPLES
    kept = (jnp.diagonal(counts) + ASSUMED_SAMPLES) / total
    both = (counts + ASSUMED_SAMPLES * t.confused) / jnp.sqrt(total[:, None] * total[None, :])
    odds = jnp.log(both) - 0.5 * jnp.log(kept[:, None] * kept[None, :])
    # What is counted of two classes of one row is of both of them alone.
    return jnp.where(jnp.eye(NAME_ROWS, dtype=bool), jnp.log(t.confused), jnp.minimum(odds, 0.0))


def name_odds(
    left: Int[Array, "N"], right: Int[Array, "X"], confused: Float[Array, "L L"]
) -> Float[Array, "N X"]:
    """Log odds of each two class numbers to be of one thing; 0 for the same."""
    found = confused[name_row(left)[:, None], name_row(right)[None, :]]
    return jnp.where(left[:, None] == right[None, :], 0.0, found)


def least_seen(t: th.Names) -> Float[Array, ""]:
    """Log odds above which the detector was seen to change between two names."""
    return jnp.log(t.confused) + LEAST_SEEN


def learn_names(
    scene: Scene, before: Int[Array, "N"], now: Int[Array, "N"], weight: Float[Array, "N"]
) -> Scene:
    """Counts which names tracklets go on under.

    Args:
      before: Class of the tracklet that each detection goes on with.
      weight: How much it teaches; 0 where nothing goes on.
    """
    rows = name_row(before), name_row(now)
    is_told = (before == now) | (rows[0] != rows[1])
    names = scene.names.at[rows].add(jnp.where(is_told, weight, 0.0))
    return dataclasses.replace(scene, names=names)


def vote(
    class_id: Int[Array, "X"],
    lead: Int[Array, "X"],
    named: Int[Array, "X"],
    votes: Bool[Array, "X"],
) -> tuple[Int[Array, "X"], Int[Array, "X"]]:
    """The class that most detections name, and its lead, after one more detection of each.

    Boyer and Moore's vote: right wherever one class has more than half of all.

    Args:
      named: Class of the next detection.
      votes: Where there is one.
    """
    left = jnp.where(named == class_id, lead + 1, lead - 1)
    changes = votes & (left < 0)
    left = jnp.where(changes, 1, left)
    return jnp.where(changes, named, class_id), jnp.where(votes, left, lead)


def name_row(class_id: Int[Array, "*any"]) -> Int[Array, "*any"]:
    """Rows of classes in what the scene knows name by name."""
    return jnp.maximum(class_id, 0) % NAME_ROWS
