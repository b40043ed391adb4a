"""The relational memories again in plain Python.

Rules: method.md#episodes, method.md#distance-episodes.
"""

import dataclasses
from typing import Any

import numpy as np

from remind_jax.remind.memory.distances import DistanceGraph


@dataclasses.dataclass
class PlainNeighbors:
    """Co-occurrence of one object: edges map an id to [count, weight, frame]."""

    same_context: float = 0.85
    debounce: int = 3
    force: int = 3
    decay: float = 1.0
    most: int = 20
    recent: bool = False
    episodes: int = 0
    last: int | None = None
    context: set | None = None
    pending: set | None = None
    hits: int = 0
    edges: dict = dataclasses.field(default_factory=dict)

    def see(self, others: set, frame: int) -> bool:
        if self.force and self.last is not None and frame - self.last >= self.force:
            return self.accept(others, frame)
        if self.context is None:
            return self.accept(others, frame)
        union = others | self.context
        if not union or len(others & self.context) / len(union) >= self.same_context:
            self.pending, self.hits = None, 0
            return False
        self.hits = self.hits + 1 if self.pending == others else 1
        self.pending = others
        if self.hits < self.debounce:
            return False
        self.pending, self.hits = None, 0
        return self.accept(others, frame)

    def accept(self, others: set, frame: int) -> bool:
        self.episodes, self.context, self.last = self.episodes + 1, others, frame
        for edge in self.edges.values():
            edge[1] *= self.decay
        for other in set(others):  # the order of a set is that of the original
            count, weight, _ = self.edges.get(other, (0, 0.0, 0))
            self.edges[other] = [count + 1, weight + 1.0, frame]
        if 0 < self.most < len(self.edges):
            self.edges = {other: self.edges[other] for other in self.order()[: self.most]}
        return True

    def order(self) -> list:
        def strength(other):
            _, weight, frame = self.edges[other]
            return frame if self.recent else (weight, frame)

        return sorted(self.edges, key=strength, reverse=True)


@dataclasses.dataclass
class PlainDistances:
    """Distances around one object; an observation is (gap or None, center, support, contact)."""

    pending: dict = dataclasses.field(default_factory=dict)
    edges: dict = dataclasses.field(default_factory=dict)  # id -> gaps, centers, supports, contacts
    orders: dict = dataclasses.field(default_factory=dict)  # (a, b) -> [distance a, distance b]

    def collect(self, other: int, observation: tuple) -> None:
        self.pending.setdefault(other, []).append(observation)

    def accept(self, context: set) -> None:
        distance = {}
        for other in sorted(context & set(self.pending)):
            gaps, centers, supports, contacts = zip(*self.pending[other], strict=True)
            primary = [c if g is None else g for g, c in zip(gaps, centers, strict=True)]
            measured = [g for g in gaps if g is not None]
            edge = self.edges.setdefault(other, ([], [], [], []))
            if measured:
                edge[0].append(_median(measured))
            edge[1].append(_median(centers))
            edge[2].append(float(np.mean(np.asarray(supports, np.float32))))
            edge[3].append(max(contacts, key=lambda c: (contacts.count(c), c)))
            distance[other] = _median(primary)
        for a in distance:
            for b in distance:
                if a < b:
                    self.orders.setdefault((a, b), []).append((distance[a], distance[b]))
        self.pending = {}


def _median(values) -> float:
    return float(np.median(np.asarray(values, np.float32)))


@dataclasses.dataclass
class PairOrder:
    """What an object remembers of the distances to two others (method.md#distance-evidence)."""

    count: np.ndarray  # episodes with both
    first_share: np.ndarray  # share of them in which the first was nearer
    margin_mean: np.ndarray
    margin_deviation: np.ndarray  # sample standard deviation


def read_order(graph: DistanceGraph, owner: Any, first: Any, second: Any) -> PairOrder:
    """Reads the cube of a distance graph; slots broadcast together."""
    nearer, margin = np.asarray(graph.nearer), np.asarray(graph.margin)
    low, high = np.minimum(first, second), np.maximum(first, second)
    won = nearer[owner, first, second]
    count = won + nearer[owner, second, first]
    spread = margin[owner, high, low] / np.maximum(1, count - 1)
    deviation = np.where(count > 1, np.sqrt(np.maximum(0, spread)), 0)
    return PairOrder(count, won / np.maximum(1, count), margin[owner, low, high], deviation)
