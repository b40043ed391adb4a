"""Tracks of undecided detections, against plain lists.

Rules: method.md#pending-joins, method.md#birth-origins.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from remind_jax.decision import NUM_OPTIONS
from remind_jax.numerics.absent import NO_ID
from remind_jax.remind.memory.pending import (
    Items,
    Kind,
    end_tracks,
    join_tracks,
    no_pending,
    open_tracks,
    write_tracks,
)
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.outcome import Pending
from remind_jax.remind.undecided.provisional_commit import claim_origins

pytestmark = pytest.mark.usefixtures("x64")

SLOTS, NUM, FRAMES, WORLDS = 80, 6, 20, 6
NUM_KNOWN, NUM_CLASSES = 6, 2
IMPOSSIBLE = 1e6


@dataclasses.dataclass(eq=False)
class Track:
    """A track as a plain record; `known` maps ids to scores."""

    kind: int
    id: int
    class_id: int
    known: dict[int, float]
    from_parent: bool
    center: np.ndarray
    area: float
    hits: int = 1


@dataclasses.dataclass
class Pool:
    tracks: list[Track] = dataclasses.field(default_factory=list)
    next_id: dict[int, int] = dataclasses.field(default_factory=lambda: {1: 0, 2: 0})
    events: set[str] = dataclasses.field(default_factory=set)

    def of_kind(self, kind: int) -> list[Track]:
        """In the order of their creation."""
        return [track for track in self.tracks if track.kind == kind]


def dice(left, right) -> float:
    return 2 * len(left & right) / (len(left) + len(right)) if left or right else 0.0


def affinity(item: Track, track: Track, visual: float, t: Pending) -> float | None:
    """How well a track continues in a detection; None if it may not."""
    if item.class_id != track.class_id:
        return None
    mine, theirs = set(item.known), set(track.known)
    empty = not mine and not theirs
    scores = [max(0.0, item.known.get(i, 0.0)) for i in mine | theirs]
    others = [max(0.0, track.known.get(i, 0.0)) for i in mine | theirs]
    total = sum(scores) + sum(others)
    shared = 2 * sum(map(min, scores, others)) / total if total > 1e-12 else 0.0
    scale = max(1.0, np.sqrt((item.area + track.area) / 2))
    away = np.linalg.norm(item.center - track.center) / (2.5 * scale)
    size = min(item.area, track.area) / max(item.area, track.area)
    place = 0.65 * max(0.0, 1 - min(1.0, away)) + 0.35 * size
    overlap = dice(mine, theirs)
    if item.kind == Kind.AMBIGUOUS:
        if not t.ambiguous_matching:
            return None
        if overlap < t.ambiguous_min_overlap or visual < t.ambiguous_min_visual:
            return None
        value = visual + t.ambiguous_overlap_weight * overlap
        value += t.ambiguous_scores_weight * shared + t.ambiguous_place_weight * place
        return value if value >= t.ambiguous_min_total else None
    if empty:
        if not t.provisional_without_parent:
            return None
        shared = 1.0
    elif not overlap:
        return None
    if visual < t.provisional_min_visual:
        return None
    value = visual + t.provisional_overlap_weight * overlap
    value += t.provisional_scores_weight * shared + t.provisional_place_weight * place
    return value if value >= t.provisional_min_total else None


def claim(pool: Pool, class_id: int, support: set[int], t: Pending) -> None:
    """A new object ends the provisional track that it grows out of."""
    waiting = [k for k in pool.of_kind(Kind.PROVISIONAL) if k.class_id == class_id]
    if support:
        best, chosen = t.origin_min_overlap, None
        for track in waiting:
            overlap = dice(support, set(track.known))
            if overlap >= best:
                best, chosen = overlap, track
        if chosen is not None:
            pool.tracks.remove(chosen)
            pool.events.add("claimed by name")
        return
    alone = [track for track in waiting if not track.from_parent]
    if len(alone) == 1:
        pool.tracks.remove(alone[0])
        pool.events.add("claimed by class")
    elif alone:
        pool.events.add("not claimed: several")


def advance(pool: Pool, items: list[Track], visual, t: Pending) -> list[int]:
    """Ids of the tracks of all items, -1 for detections that are none."""
    ids = [NO_ID] * len(items)
    for kind in (Kind.AMBIGUOUS, Kind.PROVISIONAL):
        rows = [n for n, item in enumerate(items) if item.kind == kind]
        before = pool.of_kind(kind)
        found: dict[int, Track] = {}
        for class_id in {items[n].class_id for n in rows}:
            mine = [n for n in rows if items[n].class_id == class_id]
            theirs = [track for track in before if track.class_id == class_id]
            if not theirs:
                continue
            values = [
                [affinity(items[n], track, visual[n][kind][track.id], t) for track in theirs]
                for n in mine
            ]
            cost = np.array([[IMPOSSIBLE if v is None else -v for v in row] for row in values])
            for i, j in zip(*linear_sum_assignment(cost), strict=True):
                if values[i][j] is not None:
                    found[mine[i]] = theirs[j]
                    pool.events.add(f"{Kind(kind).name} joined")
        for n in rows:
            item, track = items[n], found.get(n)
            if track is None:
                track = dataclasses.replace(item, id=pool.next_id[kind])
                pool.next_id[kind] += 1
                pool.tracks.append(track)
                pool.events.add(f"{Kind(kind).name} opened")
            for name in ("known", "from_parent", "center", "area"):
                setattr(track, name, getattr(item, name))
            track.hits += 1
            ids[n] = track.id
    return ids


@functools.partial(jax.jit, static_argnames="solver")
def step(tracks, items, visual, births, support, rules, solver):
    ended = claim_origins(tracks, births, items.class_id, support, rules)
    tracks = end_tracks(tracks, ended)
    joined = join_tracks(tracks, items, visual, rules, solver=solver)
    slot, needed = open_tracks(tracks, items, joined)
    waiting = items.kind != Kind.FREE
    slot = jnp.where(waiting, slot, SLOTS)
    written = write_tracks(tracks, items, slot, joined)
    ids = written.id.at[slot].get(mode="fill", fill_value=NO_ID)
    return written, jnp.where(waiting, ids, NO_ID), needed


def draw_items(rng, values):
    """Detections that wait, with ids and scores of few values; others may found objects."""
    items: list[Track] = []
    births = np.zeros(NUM, bool)
    for n in range(NUM):
        kind = int(rng.choice([Kind.FREE, Kind.AMBIGUOUS, Kind.PROVISIONAL], p=[0.3, 0.3, 0.4]))
        least = 2 if kind == Kind.AMBIGUOUS else 0
        names = rng.permutation(NUM_KNOWN)[: rng.integers(least, NUM_OPTIONS + 1)]
        known = {int(name): float(values(rng)) for name in names}
        births[n] = kind == Kind.FREE and rng.random() < 0.5
        place, area = rng.uniform(0, 60, 2), float(rng.uniform(50, 900))
        class_id = int(rng.integers(NUM_CLASSES))
        track = Track(kind, NO_ID, class_id, known, bool(rng.random() < 0.3), place, area)
        items.append(track)
    return items, births


def as_arrays(items) -> Items:
    known_id = np.full((NUM, NUM_OPTIONS), NO_ID, np.int32)
    known_score = np.zeros((NUM, NUM_OPTIONS))
    for n, item in enumerate(items):
        known_id[n, : len(item.known)] = list(item.known)
        known_score[n, : len(item.known)] = list(item.known.values())
    return Items.begun(
        kind=np.array([item.kind for item in items], np.int32),
        class_id=np.array([item.class_id for item in items], np.int32),
        known_id=known_id,
        known_score=known_score,
        from_parent=np.array([item.from_parent for item in items]),
        center=np.array([item.center for item in items]),
        area=np.array([item.area for item in items]),
    )  # pyright: ignore[reportArgumentType]


SETTINGS = {
    "published": {},
    "loose": {
        "ambiguous_min_overlap": 0.0,
        "ambiguous_min_visual": 0.1,
        "ambiguous_min_total": 0.3,
        "provisional_min_visual": 0.1,
        "provisional_min_total": 0.3,
        "origin_min_overlap": 0.3,
    },
    "strict": {
        "provisional_without_parent": False,
        "ambiguous_matching": False,
        "origin_min_overlap": 0.9,
    },
}


@pytest.mark.parametrize("tied", [False, True], ids=["distinct", "tied"])
@pytest.mark.parametrize("setting", SETTINGS)
def test_tracks_equal_plain_lists(setting, tied):
    """120 frames of six detections; tied scores have few values, so that assignments tie."""
    t = Pending(**SETTINGS[setting])
    rules = dataclasses.replace(Thresholds(), pending=t).as_arrays(jnp.float64).pending
    occurred: set[str] = set()
    for seed in range(WORLDS):
        rng = np.random.default_rng(seed)
        values = (lambda r: r.integers(2, 5) / 4) if tied else (lambda r: r.uniform(0.3, 1.0))
        pool, tracks = Pool(), no_pending(SLOTS, jnp.dtype("float64"))
        for _ in range(FRAMES):
            items, births = draw_items(rng, values)
            if tied:  # place alone would tell them apart
                items = [dataclasses.replace(i, center=np.zeros(2), area=64.0) for i in items]
            arrays, of_slot = as_arrays(items), np.asarray(tracks.id)
            kinds = np.asarray(tracks.kind)
            drawn = {
                (kind, track.id): [float(values(rng)) for _ in range(NUM)]
                for kind in (1, 2)
                for track in pool.of_kind(kind)
            }
            visual = np.zeros((NUM, SLOTS))
            for slot in np.flatnonzero(kinds):
                visual[:, slot] = drawn[int(kinds[slot]), int(of_slot[slot])]
            before = len(pool.tracks)
            for n in np.flatnonzero(births):
                claim(pool, items[n].class_id, set(items[n].known), t)
            seen = [
                {kind: {i: v[n] for (k, i), v in drawn.items() if k == kind} for kind in (1, 2)}
                for n in range(NUM)
            ]
            expected = advance(pool, items, seen, t)
            tracks, ids, needed = step(
                tracks, arrays, visual, births, arrays.known_id, rules, solver="jax"
            )
            assert ids.tolist() == expected, (setting, seed)
            assert needed == len(pool.tracks) <= SLOTS
            occurred |= {"claimed"} if len(pool.tracks) < before else set()
        ours = {
            (int(k), int(i)): (int(h), int(c))
            for k, i, h, c in zip(tracks.kind, tracks.id, tracks.hits, tracks.class_id, strict=True)
            if k != Kind.FREE
        }
        assert ours == {(k.kind, k.id): (k.hits, k.class_id) for k in pool.tracks}
        assert tracks.next_id.tolist() == [pool.next_id[1], pool.next_id[2]]
        occurred |= pool.events
    must = {"PROVISIONAL joined", "AMBIGUOUS opened", "claimed by name", "claimed by class"}
    if setting == "strict":
        assert "AMBIGUOUS joined" not in occurred
    else:
        must |= {"AMBIGUOUS joined", "not claimed: several"}
    assert occurred >= must, occurred
