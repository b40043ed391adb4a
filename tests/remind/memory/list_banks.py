"""Prototype banks as plain lists: method.md#banks word for word, one object at a time."""

from __future__ import annotations

import dataclasses

import numpy as np

from remind_jax.remind.thresholds.memory import Appearance, Background, Parts
from remind_jax.remind.thresholds.perception import RingPrototypes
from remind_jax.static import Static


@dataclasses.dataclass
class Prototype:
    embedding: np.ndarray  # float32
    last_seen: int
    hits: int = 1
    quality_sum: float = 1.0
    num_qualities: int = 1
    quality_recent: float = 1.0

    @classmethod
    def of(cls, vector, quality, now) -> Prototype:
        return cls(vector, now, quality_sum=quality, quality_recent=quality)

    @property
    def mean_quality(self) -> float:
        return min(1.0, max(0.0, self.quality_sum / max(1, self.num_qualities)))

    def count_quality(self, quality: float) -> None:
        self.quality_sum += quality
        self.num_qualities += 1
        rate = max(0.08, min(0.30, 1 / self.num_qualities))
        self.quality_recent = (1 - rate) * self.quality_recent + rate * quality

    def move(self, vector, rate) -> None:
        rate = np.float32(rate)
        self.embedding = unit((1 - rate) * self.embedding + rate * vector)

    def move_by_similarity(self, vector, cosine, duplicate, margin, low, high, scale) -> None:
        gate = duplicate + margin
        if cosine < gate:
            return
        share = min(1.0, max(0.0, (cosine - gate) / max(1e-6, 1 - gate)))
        rate = (low + (high - low) * share) * min(1.0, max(0.0, scale))
        if rate > 0:
            self.move(vector, rate)


@dataclasses.dataclass
class Banks:
    """Work and stable bank of one channel of one object, and what happened to them."""

    work: list[Prototype] = dataclasses.field(default_factory=list)
    stable: list[Prototype] = dataclasses.field(default_factory=list)
    events: dict[str, int] = dataclasses.field(default_factory=dict)

    def note(self, event: str) -> None:
        self.events[event] = self.events.get(event, 0) + 1


def unit(vector: np.ndarray) -> np.ndarray:
    vector = np.asarray(vector, np.float32)
    norm = np.sqrt(np.dot(vector, vector))
    return np.zeros_like(vector) if norm < 1e-12 else vector / norm


def nearest(bank: list[Prototype], vector: np.ndarray) -> tuple[int, float]:
    cosines = [float(np.dot(p.embedding, vector)) for p in bank]
    return (int(np.argmax(cosines)), max(cosines)) if bank else (-1, -np.inf)


def closest_pair(bank: list[Prototype]) -> tuple[float, int, int]:
    best = (-1.0, -1, -1)
    for i in range(len(bank)):
        for j in range(i + 1, len(bank)):
            cosine = float(np.dot(bank[i].embedding, bank[j].embedding))
            if cosine > best[0]:
                best = (cosine, i, j)
    return best


def evicted(bank: list[Prototype], policy: str) -> int:
    redundancy = []
    for i, one in enumerate(bank):
        others = [float(np.dot(one.embedding, p.embedding)) for j, p in enumerate(bank) if j != i]
        redundancy.append(max([c for c in others if c > -1], default=0.0))
    candidates = list(range(len(bank)))
    if policy == "redundant":
        candidates = [i for i in candidates if abs(redundancy[i] - max(redundancy)) < 1e-6]
    return min(candidates, key=lambda i: bank[i].last_seen)


def merged(left: Prototype, right: Prototype, now: int, cap: int | None) -> Prototype:
    weights = (1, 1) if cap is None else (min(left.hits, cap), min(right.hits, cap))
    joined = Prototype(
        unit(np.float32(weights[0]) * left.embedding + np.float32(weights[1]) * right.embedding),
        max(left.last_seen, right.last_seen, now),
        left.hits + right.hits,
        left.quality_sum + right.quality_sum,
        left.num_qualities + right.num_qualities,
    )
    joined.quality_recent = joined.mean_quality
    return joined


def insert(banks, bank, value, capacity, merge, policy, cap, now, name) -> None:
    """Adds to a bank; a full one merges its closest pair or gives up a prototype before."""
    if len(bank) >= capacity:
        cosine, i, j = closest_pair(bank)
        if cosine >= merge:
            bank[i] = merged(bank[i], bank[j], now, cap)
            del bank[j]
            banks.note(f"{name}: merge")
        else:
            del bank[evicted(bank, policy)]
            banks.note(f"{name}: evict")
    bank.append(value)
    banks.note(f"{name}: insert")


def update_appearance(
    banks: Banks, vector, quality, now, static: Static, t: Appearance, may_insert=True, rate=1.0
) -> None:
    """method.md#appearance-learning."""
    cap = t.merge_cap if static.appearance_merge == "capped" else None

    def refresh(prototype, cosine, duplicate, least) -> None:
        prototype.hits += 1
        prototype.last_seen = now
        if quality >= least:
            if not t.gated_update:
                prototype.move(vector, quality)
            else:
                prototype.move_by_similarity(
                    vector, cosine, duplicate, t.update_margin, t.update_rate_min,
                    t.update_rate_max, rate * quality,
                )  # fmt: skip
        prototype.count_quality(quality)

    i, in_stable = nearest(banks.stable, vector)
    if in_stable >= t.stable_duplicate:
        refresh(banks.stable[i], in_stable, t.stable_duplicate, t.stable_quality)
        return banks.note("stable: refresh")
    i, in_work = nearest(banks.work, vector)
    if in_work >= t.duplicate and not t.refresh_work:
        return banks.note("work: left alone")
    if in_work >= t.duplicate:
        refresh(banks.work[i], in_work, t.duplicate, t.work_quality)
        banks.note("work: refresh")
        proven = banks.work[i]
        if not may_insert or t.promote_hits <= 0 or proven.hits < t.promote_hits:
            return None
        if proven.mean_quality < t.promote_quality:
            return banks.note("work: quality too low to promote")
        j, cosine = nearest(banks.stable, proven.embedding)
        del banks.work[i]
        if cosine >= t.stable_duplicate:
            banks.stable[j] = merged(banks.stable[j], proven, now, cap)
            return banks.note("stable: join")
        return insert(
            banks, banks.stable, proven, static.appearance_slots[1], t.stable_merge,
            static.appearance_stable_evict, cap, now, "stable",
        )  # fmt: skip
    if not may_insert or quality < t.create_quality:
        return banks.note("skip")
    if static.appearance_insert == "novel" and max(in_stable, in_work) > t.novel:
        return banks.note("not novel")
    return insert(
        banks, banks.work, Prototype.of(vector, quality, now), static.appearance_slots[0], t.merge,
        static.appearance_evict, cap, now, "work",
    )  # fmt: skip


def update_background(
    banks: Banks, vector, quality, now, slots, policy, t: Background, may_insert=True, rate=1.0
) -> None:
    """method.md#background-learning."""
    i, cosine = nearest(banks.stable, vector)
    if cosine >= t.stable_duplicate:
        prototype = banks.stable[i]
        prototype.hits += 1
        prototype.last_seen = now
        if quality >= t.stable_quality and t.stable_update:
            prototype.move_by_similarity(
                vector, cosine, t.stable_duplicate, t.stable_margin, t.stable_rate_min,
                t.stable_rate_max, rate * quality,
            )  # fmt: skip
        prototype.count_quality(quality)
        return banks.note("stable: refresh")
    i, cosine = nearest(banks.work, vector)
    if cosine >= t.duplicate:
        prototype = banks.work[i]
        prototype.hits += 1
        prototype.last_seen = now
        if quality >= t.work_quality:
            prototype.move_by_similarity(
                vector, cosine, t.duplicate, t.update_margin, t.update_rate_min,
                t.update_rate_max, rate * quality,
            )  # fmt: skip
        prototype.count_quality(quality)
        banks.note("work: refresh")
        proven = prototype.hits >= t.promote_hits and prototype.mean_quality >= t.promote_quality
        if not may_insert or not proven:
            return None
        j, joint = nearest(banks.stable, prototype.embedding)
        if joint >= t.stable_duplicate:
            banks.stable[j] = merged(banks.stable[j], prototype, now, t.merge_cap)
            del banks.work[i]
            return banks.note("stable: join")
        if len(banks.stable) < slots[1]:
            banks.stable.append(prototype)
            del banks.work[i]
            return banks.note("stable: insert")
        return banks.note("stable: full")
    if not may_insert or quality < t.create_quality:
        return banks.note("skip")
    return insert(
        banks, banks.work, Prototype.of(vector, quality, now), slots[0], t.merge, policy,
        t.merge_cap, now, "work",
    )  # fmt: skip


def update_parts(
    banks: Banks, vectors, now, static: Static, t: Parts, may_insert=True, rate=1.0
) -> None:
    """method.md#part-learning: the parts of one detection, in order."""
    cap = t.merge_cap if static.part_merge == "capped" else None
    used: set[int] = set()

    def refresh(prototype, vector, cosine, duplicate) -> None:
        prototype.hits += 1
        prototype.last_seen = now
        prototype.move_by_similarity(
            vector, cosine, duplicate, t.update_margin, t.update_rate_min, t.update_rate_max, rate
        )

    def put(bank, vector, capacity, merge, name) -> None:
        value = Prototype.of(vector, 1.0, now)
        insert(banks, bank, value, capacity, merge, static.part_evict, cap, now, name)

    for vector in vectors:
        if not banks.work:
            if may_insert:
                put(banks.work, vector, static.part_slots[0], t.merge, "work")
            continue
        cosines = [float(np.dot(p.embedding, vector)) for p in banks.work]
        i = int(np.argmax(cosines))
        if t.one_to_one and i in used and len(banks.work) > 1:
            free = [j for j in np.argsort(-np.array(cosines), kind="stable") if j not in used]
            if free:
                i = int(free[0])
                banks.note("redirected")
        if cosines[i] >= t.duplicate:
            used.add(i)
            prototype = banks.work[i]
            refresh(prototype, vector, cosines[i], t.duplicate)
            banks.note("work: refresh")
            if may_insert and t.promote_hits > 0 and prototype.hits >= t.promote_hits:
                j, joint = nearest(banks.stable, prototype.embedding)
                if joint >= t.stable_duplicate:
                    refresh(banks.stable[j], prototype.embedding, joint, t.stable_duplicate)
                    banks.note("stable: refresh")
                else:
                    put(
                        banks.stable, prototype.embedding, static.part_slots[1], t.stable_merge,
                        "stable",
                    )  # fmt: skip
            continue
        full = len(banks.work) >= static.part_slots[0]
        if static.part_insert == "novel" and full and cosines[i] > t.novel:
            banks.note("not novel")
        elif may_insert:
            put(banks.work, vector, static.part_slots[0], t.merge, "work")


def update_ring_prototypes(
    banks: Banks, vectors, now, slots, policy, t: Background, r: RingPrototypes, may_insert=True,
    rate=1.0,
) -> None:  # fmt: skip
    """method.md#ring-prototype-learning: the prototypes of one ring of one detection, in order."""
    for vector in vectors:
        i, cosine = nearest(banks.work, vector)
        if cosine >= t.duplicate:
            prototype = banks.work[i]
            prototype.hits += 1
            prototype.last_seen = now
            prototype.move_by_similarity(
                vector, cosine, t.duplicate, t.update_margin, t.update_rate_min,
                t.update_rate_max, rate,
            )  # fmt: skip
            banks.note("work: refresh")
        elif may_insert:
            value = Prototype.of(vector, 1.0, now)
            insert(banks, banks.work, value, slots[0], t.merge, policy, t.merge_cap, now, "work")
        i, _ = nearest(banks.work, vector)
        if i < 0 or not may_insert or banks.work[i].hits < r.promote_hits:
            continue
        proven = banks.work[i].embedding
        j, cosine = nearest(banks.stable, proven)
        if cosine >= t.stable_duplicate:
            prototype = banks.stable[j]
            prototype.hits += 1
            prototype.last_seen = now
            if t.stable_update:
                prototype.move_by_similarity(
                    proven, cosine, t.stable_duplicate, t.stable_margin, t.stable_rate_min,
                    t.stable_rate_max, rate,
                )  # fmt: skip
            banks.note("stable: refresh")
            continue
        banks.stable.append(Prototype.of(proven, 1.0, now))
        banks.note("stable: insert")
        if len(banks.stable) > slots[1]:
            del banks.stable[0]
            banks.note("stable: first out")
        cosine, i, j = closest_pair(banks.stable)
        if cosine >= r.stable_merge:
            banks.stable[i] = merged(banks.stable[i], banks.stable[j], now, t.merge_cap)
            del banks.stable[j]
            banks.note("stable: merge")


def random_views(rng, *shape, dim=4, directions=5, spread=0.2) -> np.ndarray:
    """Unit vectors around a few directions, so that duplicates, merges and novelties all occur."""
    centers = rng.standard_normal((directions, dim))
    centers /= np.linalg.norm(centers, axis=1, keepdims=True)
    views = centers[rng.integers(0, directions, shape)]
    views = views + spread * rng.random((*shape, 1)) * rng.standard_normal((*shape, dim))
    return (views / np.linalg.norm(views, axis=-1, keepdims=True)).astype(np.float32)


def assert_same(bank, prototypes: list[Prototype], where, qualities: bool = True) -> None:
    """Compares a fixed-slot bank with a list, free slots included in nothing."""
    size = int(bank.size)
    assert size == len(prototypes), where
    assert size <= len(bank.hits)
    assert bank.hits[:size].tolist() == [p.hits for p in prototypes], where
    assert bank.last_seen[:size].tolist() == [p.last_seen for p in prototypes], where
    if not size:
        return
    ours, theirs = bank.embedding[:size], np.stack([p.embedding for p in prototypes])
    # some tens of float32 steps
    np.testing.assert_allclose(ours, theirs, atol=1e-5, err_msg=str(where))
    np.testing.assert_allclose(np.linalg.norm(ours, axis=-1), 1.0, atol=1e-6)
    if qualities:
        for field in ("quality_sum", "num_qualities", "quality_recent"):
            theirs = [getattr(p, field) for p in prototypes]
            np.testing.assert_allclose(getattr(bank, field)[:size], theirs, atol=1e-9)


def descriptors_of(num: int, **fields):
    """Descriptors of `num` detections with nothing in them but the given fields."""
    from remind_jax.observation import Descriptors

    dim = max(
        [v.shape[-1] for k, v in fields.items() if k in ("appearance", "parts", "rings")], default=1
    )
    empty = dict(
        appearance=np.zeros((num, 2, dim), np.float32),
        appearance_valid=np.zeros((num, 2), bool),
        parts=np.zeros((num, 1, 1, dim), np.float32),
        parts_valid=np.zeros((num, 1, 1), bool),
        rings=np.zeros((num, 2, dim), np.float32),
        rings_valid=np.zeros((num, 2), bool),
        num_patches=np.zeros(num, np.int32),
        patch_sum=np.zeros(num),
        num_parts=np.zeros(num, np.int32),
        part_support=np.zeros(num),
        ring_patches=np.zeros((num, 2), np.int32),
        mask_quality=np.ones(num),
        class_id=np.zeros(num, np.int32),
        valid=np.ones(num, bool),
        num_bad_patches=np.int32(0),
    )
    return Descriptors(**{**empty, **fields})
