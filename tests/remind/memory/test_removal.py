"""Births, absences and removals over many frames, against method.md#lifecycle as plain lists."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.memory.objects import (
    Lifecycle,
    create_objects,
    mark_missed,
    mark_seen,
)
from remind_jax.remind.state import BANKS, TrackerState, init, remove_objects
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Lifecycle as Rules
from tests.remind.memory.small_banks import with_records
from tests.statics import make_static

NUM, FRAMES = 3, 60
STATIC = make_static(
    num_objects=24, num_detections=NUM, num_pending=2, feature_dim=2, ring_prototypes=True
)


@dataclasses.dataclass
class Object:
    """What is counted of an object."""

    id: int
    class_id: int
    state: str = "NEW"
    hits: int = 0
    misses: int = 0
    age: int = 0

    def see(self, t: Rules) -> None:
        self.hits, self.misses, self.age = self.hits + 1, 0, self.age + 1
        waits = self.state in ("NEW", "TENTATIVE") and self.hits < t.confirm_hits
        self.state = "TENTATIVE" if waits else "CONFIRMED"

    def miss(self, t: Rules) -> bool:
        """Whether the object is to be removed."""
        self.misses, self.age = self.misses + 1, self.age + 1
        if self.state in ("NEW", "TENTATIVE"):
            self.state = "TENTATIVE"
            return 0 < t.max_misses_tentative <= self.misses
        if self.state == "CONFIRMED":
            if 0 < t.max_misses_confirmed <= self.misses:
                self.state = "INACTIVE"
            return False
        return 0 < t.max_misses_inactive <= self.misses


def step(state: TrackerState, class_id, is_new, seen, spared, rules: Rules) -> TrackerState:
    """The lifecycle part of a frame, as `memory.update` has it; new objects are marked."""
    objects, slot = create_objects(state.objects, class_id, is_new, state.next_id)
    seen = seen.at[slot].set(True, mode="drop")
    objects = mark_seen(objects, seen.astype(jnp.int32), state.frame, rules)
    objects, gone = mark_missed(objects, objects.exists & ~seen & ~spared, rules)
    state = dataclasses.replace(
        state, objects=objects, next_id=state.next_id + jnp.sum(is_new, dtype=jnp.int32)
    )
    return remove_objects(mark(state, slot), gone)


def mark(state: TrackerState, slot) -> TrackerState:
    """Writes ids wherever memory keeps something of a new object, or of a pair with one."""
    own = state.objects.id + 1
    fresh = jnp.zeros(own.shape, bool).at[slot].set(True, mode="drop")
    pair = jnp.where(fresh[:, None] | fresh, own[:, None] * 100 + own, 0)

    def of_banks(banks):
        rows = jnp.concatenate([fresh, jnp.zeros(STATIC.num_pending, bool)])
        ids = jnp.concatenate([own, jnp.zeros(STATIC.num_pending, own.dtype)])

        size = jnp.where(rows, 1, banks.size).astype(banks.size.dtype)
        hits = jnp.where(rows[:, None], ids[:, None], banks.hits)
        return with_records(dataclasses.replace(banks, size=size), hits=hits)

    graph, distances = state.cooccurrence, state.distances
    some = fresh[:, None, None] | fresh[:, None] | fresh
    triple = own[:, None, None] * 10_000 + own[:, None] * 100 + own

    def of_pairs(leaf):
        return jnp.where(pair > 0, pair, leaf).astype(leaf.dtype)

    return dataclasses.replace(
        state,
        cooccurrence=dataclasses.replace(
            graph,
            episodes=jnp.where(fresh, own, graph.episodes).astype(graph.episodes.dtype),
            count=of_pairs(graph.count),
        ),
        distances=dataclasses.replace(
            distances,
            edges=distances.edges.replaced(gap_count=of_pairs(distances.edges.gap_count)),
            nearer=jnp.where(some, triple, distances.nearer).astype(distances.nearer.dtype),
        ),
        **{name: of_banks(getattr(state, name)) for name in BANKS},
    )


STEP = jax.jit(step)


@pytest.mark.parametrize(
    "limits",
    [
        {"max_misses_tentative": 2, "max_misses_confirmed": 2, "max_misses_inactive": 4},
        {"confirm_hits": 4, "max_misses_tentative": 1, "max_misses_inactive": 3,
         "max_misses_confirmed": 5},
        {"confirm_hits": 1, "max_misses_tentative": 3, "max_misses_confirmed": 1,
         "max_misses_inactive": 2},
        {"max_misses_tentative": 0, "max_misses_confirmed": 3, "max_misses_inactive": 5},
    ],
)  # fmt: skip
@pytest.mark.parametrize("seed", range(3))
def test_objects_come_and_go_as_in_plain_lists(limits, seed):
    """What stays in memory is that of the objects that stay, in the order of their ids."""
    t = Rules(**limits)
    rules = dataclasses.replace(Thresholds(), lifecycle=t).as_arrays(jnp.float32).lifecycle
    rng = np.random.default_rng(seed)
    state, plain, next_id, removed = init(STATIC), [], 0, 0
    for frame in range(FRAMES):
        is_new = rng.random(NUM) < 0.15
        class_id = rng.integers(0, 5, NUM).astype(np.int32)
        slots = np.arange(STATIC.num_objects)
        seen = (rng.random(len(slots)) < 0.45) & (slots < len(plain))
        spared = (rng.random(len(slots)) < 0.2) & (slots < len(plain)) & ~seen
        state = STEP(state, class_id, is_new, jnp.asarray(seen), spared, rules)

        for position, one in enumerate(plain):
            if seen[position]:
                one.see(t)
        kept = [
            one
            for position, one in enumerate(plain)
            if seen[position] or spared[position] or not one.miss(t)
        ]
        removed += len(plain) - len(kept)
        for detection in np.flatnonzero(is_new):
            kept.append(Object(next_id, int(class_id[detection])))
            kept[-1].see(t)
            next_id += 1
        plain = kept
        assert len(plain) <= STATIC.num_objects

        where = (limits, seed, frame)
        o, num = jax.device_get(state.objects), len(plain)
        ours = [
            Object(int(i), int(c), Lifecycle(s).name, int(h), int(m), int(a))
            for i, c, s, h, m, a in zip(
                o.id, o.class_id, o.lifecycle, o.hits, o.misses, o.age, strict=True
            )
            if i >= 0
        ]
        assert ours == plain, where
        assert (o.id[num:] == -1).all()
        assert int(state.next_id) == next_id
        own = np.array([one.id + 1 for one in plain], np.int64)
        pairs = own[:, None] * 100 + own
        graph = jax.device_get(state.cooccurrence)
        np.testing.assert_array_equal(graph.episodes[:num], own, str(where))
        np.testing.assert_array_equal(graph.count[:num, :num], pairs, str(where))
        assert not graph.count[num:].any()
        assert not graph.count[:, num:].any()
        count = np.asarray(state.distances.edges.gap_count)
        np.testing.assert_array_equal(count[:num, :num], pairs, str(where))
        triples = own[:, None, None] * 10_000 + pairs
        nearer = np.asarray(state.distances.nearer)
        np.testing.assert_array_equal(nearer[:num, :num, :num], triples, str(where))
        for name in BANKS:
            bank = getattr(state, name)
            assert (np.asarray(bank.hits)[..., :num, 0] == own).all(), where
            assert (np.asarray(bank.size)[..., :num] == 1).all()
            assert not np.asarray(bank.size)[..., num : STATIC.num_objects].any()
    assert removed > 5
