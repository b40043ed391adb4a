"""Properties of the whole step, on a tiny world.

Whole numbers and decisions must agree exactly. Real ones may differ by what another shape of a
matrix product does to sums of float32: a few ulps, a hundred times less than `CLOSE`.
"""

import dataclasses
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.compiled.frame_step import settle_types
from remind_jax.decision import Outcome, Reason
from remind_jax.numerics.absent import NO_ID
from remind_jax.remind.memory.pending import Kind
from remind_jax.remind.method import METHOD
from remind_jax.remind.stages import Stages
from remind_jax.remind.state import TrackerState, init
from tests import tiny_world as world
from tests.statics import change_static

CLOSE = 2e-5
SEED = 2  # a world that brings every kind of decision and fits the capacities
NUM_SWEPT = 16  # frames
STRANGERS = world.make_frames(1, seed=11, share=1.0)
LARGER = change_static(world.STATIC, num_detections=9, num_objects=20, num_pending=17)


def assert_same(ours: Any, theirs: Any, close: float = CLOSE) -> None:
    """All leaves agree to `close`, which whole numbers never differ by."""
    chex.assert_trees_all_close(ours, theirs, atol=close, rtol=close)


def assert_same_state(ours: TrackerState, theirs: TrackerState) -> None:
    """Memories agree, and so do the decisions about detections in use."""
    assert_same(world.decided(ours), world.decided(theirs))
    undecided = lambda state: dataclasses.replace(state, decisions=None)  # noqa: E731
    assert_same(undecided(ours), undecided(theirs))


@pytest.fixture(scope="module")
def frames() -> list[world.Frame]:
    return world.make_frames(40, SEED)


@pytest.fixture(scope="module")
def followed(frames) -> list[tuple[TrackerState, Stages]]:
    return world.follow(frames)


@pytest.fixture(scope="module")
def states(followed) -> list[TrackerState]:
    return [state for state, _ in followed]


def test_the_world_brings_every_kind_of_decision(states, followed):
    """Else the tests below would show little."""
    outcomes = np.concatenate([world.decided(state)["outcome"] for state in states])
    assert {*map(int, outcomes)} >= {Outcome.MATCH, Outcome.NEW, Outcome.AMBIGUOUS}
    stages = [stages for _, stages in followed]
    assert any((s.candidate_bonus != 0).any() for s in stages)
    assert any((s.source > 1).any() for s in stages)
    assert any((s.assigned_id != s.guarded_id).any() for s in stages)
    assert not any(state.overflow.objects or state.overflow.pending for state in states)


def batch(*trees: Any) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def row(tree: Any, *index: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


@pytest.fixture(scope="module")
def sweep(frames, states) -> TrackerState:
    """States `[scene, frame]` of one program with larger capacities.

    `vmap` over two scenes with memories of their own, around `scan` over frames: the world itself,
    and strangers who meet a full memory.
    """
    scenes = [frames[:NUM_SWEPT], STRANGERS * NUM_SWEPT]
    memories = [init(LARGER), METHOD.enlarge(states[-1], LARGER)]
    thresholds = world.THRESHOLDS.as_arrays(LARGER.scalar)

    def track(state: TrackerState, scene: world.Frame) -> TrackerState:
        def advance(state, frame):
            stepped = METHOD.step(state, *frame, static=LARGER, thresholds=thresholds)
            return settle_types(stepped), stepped

        return jax.lax.scan(advance, state, scene)[1]

    padded = [world.pad(scene, LARGER.num_detections) for scene in scenes]
    return jax.device_get(
        jax.jit(jax.vmap(track))(
            settle_types(batch(*memories)),
            batch(*(batch(*scene) for scene in padded)),
        )
    )


@pytest.mark.slow
def test_capacities_scan_and_vmap_change_nothing(states, sweep):
    for t, state in enumerate(states[:NUM_SWEPT]):
        assert_same_state(METHOD.enlarge(state, LARGER), row(sweep, 0, t))


@pytest.mark.parametrize("start", [0, 15])
def test_order_of_detections_changes_only_ids_of_simultaneous_births(followed, start):
    """From frame 15 on nothing is born: then shuffling changes nothing at all.

    With other ids, hypotheses of equal score are kept in another order, and the context that
    they add to scores varies; what is decided does not.
    """
    rng, orders = np.random.default_rng(5), []

    def shuffle(boxes: list[int]) -> list[int]:
        mixed = len(orders) >= start
        orders.append(rng.permutation(len(boxes)) if mixed else np.arange(len(boxes)))
        return [boxes[i] for i in orders[-1]]

    shuffled = world.follow(world.make_frames(40, SEED, order=shuffle))
    renamed = {NO_ID: NO_ID}
    for plain, other, order in zip(followed, shuffled, orders, strict=True):
        a = {name: values[order] for name, values in world.decided(*plain).items()}
        b = world.decided(*other)
        is_new = b["outcome"] == Outcome.NEW
        renamed |= dict(zip(a["object_id"][is_new], b["object_id"][is_new], strict=True))
        for name in ("outcome", "reason", "status", "num_close", "lock", "source"):
            np.testing.assert_array_equal(a[name], b[name], name)
        for name in ("object_id", "option_id", "assigned_id", "guarded_id"):
            np.testing.assert_array_equal(rename(a[name], renamed), b[name], name)
        for name in ("best_score", "second_score", "confidence"):
            np.testing.assert_allclose(a[name], b[name], atol=CLOSE, err_msg=name)
        if start > 0:
            assert_same({**a, "pending_id": b["pending_id"]}, b)
    changed = [old for old, new in renamed.items() if old != new]
    assert bool(changed) == (start == 0)


def rename(ids: np.ndarray, names: dict[int, int]) -> np.ndarray:
    return np.array([names[i] for i in ids.ravel()], np.int32).reshape(ids.shape)


def test_empty_frame_only_ages_the_memory(states):
    before = states[-1]
    nothing = world.make_frames(1, SEED, share=0.0)
    (after,) = world.run(nothing, state=before)
    assert (after.decisions.outcome == Outcome.EMPTY).all()
    assert after.frame == before.frame + 1
    aged = dataclasses.replace(
        before.objects,
        misses=before.objects.misses + before.objects.exists,
        age=before.objects.age + before.objects.exists,
        lifecycle=after.objects.lifecycle,  # some come to rest: tested with the lifecycle
    )
    assert_same(aged, after.objects, close=0)
    for part in ("wholes", "parts", "next_id"):
        assert_same(getattr(before, part), getattr(after, part), close=0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_features_that_are_not_finite_never_reach_memory(states, bad):
    feats, masks = world.make_frames(1, SEED, share=1.0)[0]
    patches = np.array(feats.patches)
    hidden = masks.coverage[2] > 0  # nothing is left of one detection, half of another
    patches[hidden] = bad
    partly = np.argwhere(masks.coverage[4] > 0)[::2]
    patches[tuple(partly.T)] = bad
    spoiled = dataclasses.replace(feats, patches=patches)
    clean = world.make_frames(1, SEED, share=1.0)[0]
    first, second = world.run([(spoiled, masks), clean], state=states[-1])
    assert first.decisions.num_bad_patches == hidden.sum() + len(partly)
    assert first.decisions.outcome[2] == Outcome.DROPPED
    assert first.decisions.reason[2] == Reason.INVALID_INPUT
    assert first.decisions.object_id[2] == NO_ID
    others = np.arange(world.BOXES) != 2
    assert (first.decisions.outcome[others] != Outcome.DROPPED).all()
    assert second.decisions.num_bad_patches == 0
    for leaf in jax.tree.leaves([first, second]):
        assert np.isfinite(leaf).all()


@pytest.mark.slow
def test_overflow_is_flagged_and_changes_nothing_else(states, sweep):
    """Strangers fill the memory; grown, it takes the same frame."""
    before = states[-1]
    (after,) = world.run(STRANGERS, state=before)
    needed = int(after.overflow.objects)
    assert world.STATIC.num_objects < needed <= LARGER.num_objects
    assert_same(dataclasses.replace(after, overflow=before.overflow), before, close=0)

    grown = row(sweep, 1, 0)
    assert grown.overflow.objects == 0
    assert (grown.objects.id != NO_ID).sum() == needed
    assert (np.diff(grown.objects.id[:needed]) > 0).all()
    num_new = (world.decided(grown)["outcome"] == Outcome.NEW).sum()
    assert num_new == needed - before.objects.exists.sum()
    # Seen again, the strangers are known.
    last = world.decided(row(sweep, 1, NUM_SWEPT - 1))
    assert (last["outcome"] != Outcome.NEW).all()


MANY = 100  # more than any id or class of the world


def fill_pending(state: TrackerState) -> TrackerState:
    """Strangers of another class in all free slots of undecided tracks."""
    tracks = state.pending
    free = tracks.kind == Kind.FREE
    numbers = MANY + np.arange(len(free), dtype=np.int32)
    filled = dataclasses.replace(
        tracks,
        kind=np.where(free, np.int32(Kind.AMBIGUOUS), tracks.kind),
        id=np.where(free, numbers, tracks.id),
        class_id=np.where(free, np.int32(MANY), tracks.class_id),
    )
    return dataclasses.replace(state, pending=filled)


def count_tracks(state: TrackerState) -> int:
    return int((np.asarray(state.pending.kind) != Kind.FREE).sum())


def test_undecided_tracks_alone_overflow_and_change_nothing_else(frames, states):
    opens = [
        at
        for at in range(1, len(frames))
        if count_tracks(states[at]) > count_tracks(states[at - 1])
        and (states[at].decisions.outcome != Outcome.NEW).all()
    ]
    assert opens
    at = opens[-1]
    before = fill_pending(states[at - 1])
    (after,) = world.run([frames[at]], state=before)
    added = count_tracks(states[at]) - count_tracks(states[at - 1])
    assert after.overflow.pending == world.STATIC.num_pending + added
    assert after.overflow.objects == 0
    assert_same(dataclasses.replace(after, overflow=before.overflow), before, close=0)

    # With room for them the tracks move as a whole, and the strangers with them.
    grown = METHOD.enlarge(
        before, change_static(world.STATIC, num_pending=2 * len(before.pending.id))
    )
    assert count_tracks(grown) == world.STATIC.num_pending
    np.testing.assert_array_equal(grown.pending.id[: world.STATIC.num_pending], before.pending.id)


@pytest.mark.slow
@pytest.mark.parametrize("change", [{"solver": "host"}, {"num_candidates": 8}])
def test_decisions_do_not_depend_on(frames, states, change):
    other = world.run(frames, change_static(world.STATIC, **change))
    shown = min(world.STATIC.num_candidates, other[0].decisions.candidate_id.shape[1])
    for state, expected in zip(other, states, strict=True):
        ours, theirs = world.decided(state), world.decided(expected)
        for name in ours:
            visible = np.s_[:, :shown] if name.startswith("candidate") else np.s_[:]
            assert_same(ours[name][visible], theirs[name][visible])


@pytest.mark.slow
def test_decisions_do_not_depend_on_compiler_options(frames, states, optimized):
    compiled = jax.jit(METHOD.step, static_argnames="static")
    state = init(world.STATIC)
    thresholds = world.THRESHOLDS.as_arrays(world.STATIC.scalar)
    for frame, expected in zip(frames, states, strict=True):
        state = compiled(state, *frame, static=world.STATIC, thresholds=thresholds)
        assert_same(state.decisions, expected.decisions)
