"""What detections of a scene look like to some features, and how alike they are.

Letters: `V` views, `S` comparisons, `M` views of a memory, `A` appearance channels, `R` rings, `K`
parts, `D` feature dimension.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from remind_jax.calibration.comparisons import NONE, Comparisons
from remind_jax.calibration.estimate import Evidence

_AT_ONCE = 64  # comparisons


@dataclasses.dataclass(frozen=True)
class Views:
    """Unit vectors of detections, zero where not present (method.md#described-frame)."""

    appearance: Float[np.ndarray, "V A D"]
    appearance_seen: Bool[np.ndarray, "V A"]
    rings: Float[np.ndarray, "V R D"]
    rings_seen: Bool[np.ndarray, "V R"]
    parts: Float[np.ndarray, "V K D"]  # by falling support
    parts_seen: Bool[np.ndarray, "V K"]

    def __len__(self) -> int:
        return len(self.appearance)

    @property
    def num_bytes(self) -> int:
        """Memory that the arrays take."""
        return sum(getattr(self, field.name).nbytes for field in dataclasses.fields(self))

    @classmethod
    def join(cls, several: Sequence[Views]) -> Views:
        """The views of several frames, one after the other."""
        names = [field.name for field in dataclasses.fields(cls)]
        return cls(
            **{name: np.concatenate([getattr(one, name) for one in several]) for name in names}
        )

    def part_cosines(self) -> Float[np.ndarray, "P"]:
        """Cosines between the parts of one view."""
        first, second = np.triu_indices(self.parts.shape[1], 1)
        cosines = np.einsum("vkd,vkd->vk", self.parts[:, first], self.parts[:, second])
        return cosines[self.parts_seen[:, first] & self.parts_seen[:, second]].astype(float)

    def merge_parts(self, merge: float) -> Views:
        """Without parts that are closer than this to a stronger one (method.md#k-means-parts)."""
        seen = self.parts_seen.copy()
        for part in range(1, seen.shape[1]):
            for stronger in range(part):
                cosine = np.sum(self.parts[:, part] * self.parts[:, stronger], axis=-1)
                seen[:, part] &= ~(seen[:, stronger] & (cosine > merge))
        return dataclasses.replace(self, parts_seen=seen)


def compare_views(
    views: Views, comparisons: Comparisons, ring_shares: tuple[float, float], part_top: int
) -> Evidence:
    """Terms of the visual score of each query with a memory, as the tracker has them.

    Rules: method.md#channel-scores, method.md#visual-score.
    """
    value, present = [np.zeros((0, 3))], [np.zeros((0, 3), bool)]
    for first in range(0, len(comparisons.query), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        query, memory = comparisons.query[some], comparisons.memory[some]
        terms = (
            _best_channel(views, query, memory),
            _join_rings(views, query, memory, ring_shares),
            _best_parts(views, query, memory, part_top),
        )
        value.append(np.stack([term for term, _ in terms], axis=1).astype(float))
        present.append(np.stack([seen for _, seen in terms], axis=1))
    return Evidence(np.concatenate(value), np.concatenate(present))


def _nearest(
    vectors: Float[np.ndarray, "V C D"],
    seen: Bool[np.ndarray, "V C"],
    query: np.ndarray,
    memory: np.ndarray,
) -> tuple[Float[np.ndarray, "S C"], Bool[np.ndarray, "S C"]]:
    """Best cosine of each channel of a query, and whether both sides have the channel."""
    cosine = np.einsum("scd,smcd->smc", vectors[query], vectors[memory])
    both = seen[query][:, None] & seen[memory] & (memory != NONE)[:, :, None]
    return np.where(both, np.maximum(cosine, 0.0), 0.0).max(axis=1), both.any(axis=1)


def _best_channel(views: Views, query: np.ndarray, memory: np.ndarray) -> tuple[Any, Any]:
    best, present = _nearest(views.appearance, views.appearance_seen, query, memory)
    return best.max(axis=1), np.any(present, axis=1)


def _join_rings(
    views: Views, query: np.ndarray, memory: np.ndarray, shares: tuple[float, float]
) -> tuple[Any, Any]:
    best, present = _nearest(views.rings, views.rings_seen, query, memory)
    counted = np.array(shares) * present
    joint = (best * counted).sum(axis=1) / np.maximum(counted.sum(axis=1), 1e-12)
    return joint, np.any(present, axis=1)


def _best_parts(views: Views, query: np.ndarray, memory: np.ndarray, top: int) -> tuple[Any, Any]:
    cosine = np.einsum("skd,smjd->skmj", views.parts[query], views.parts[memory])
    there = views.parts_seen[memory] & (memory != NONE)[:, :, None]
    both = views.parts_seen[query][:, :, None, None] & there[:, None]
    best = np.where(both, np.maximum(cosine, 0.0), -1.0).max(axis=(2, 3))
    best = -np.sort(-best, axis=1)[:, :top]
    count = (best >= 0).sum(axis=1)
    mean = np.where(best >= 0, best, 0.0).sum(axis=1) / np.maximum(count, 1)
    return mean, count > 0
