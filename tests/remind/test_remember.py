"""What memory makes of the decisions of a frame: births, absences, undecided tracks, overflow."""

from __future__ import annotations

import dataclasses
import functools
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.decision import NUM_OPTIONS, Outcome, Reason, Status, no_decisions
from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.observation import Descriptors
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.memory.pending import Kind
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.remember import gate_updates, remember
from remind_jax.remind.stages import Lock
from remind_jax.remind.state import TrackerState, init
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Update
from tests.statics import make_static

NUM, SLOTS, PENDING, DIM = 3, 3, 2, 4
STATIC = make_static(
    num_detections=NUM,
    num_objects=SLOTS,
    num_pending=PENDING,
    feature_dim=DIM,
    appearance_slots=(3, 2),
    part_slots=(2, 2),
    inner_ring_slots=(2, 2),
    outer_ring_slots=(2, 2),
)
CUP, PLATE = 0, 1
VIEWS = np.eye(NUM, DIM, dtype=np.float32)  # detection n looks like axis n


@functools.partial(jax.jit, static_argnames="static")
def _remember(state, given, static):
    t = Thresholds().as_arrays(static.scalar)
    seen = given["outcome"] != Outcome.EMPTY
    decisions = dataclasses.replace(
        no_decisions(static),
        outcome=given["outcome"],
        option_id=given["options"],
        option_score=jnp.where(given["options"] >= 0, 0.8, 0.0),
    )
    stages: Any = SimpleNamespace(
        status_final=jnp.full(NUM, Status.STRONG),
        lock=jnp.full(NUM, Lock.NONE),
        assigned_id=jnp.full(NUM, NO_ID),
    )
    settlement: Any = SimpleNamespace(
        slot=given["slot"],
        source=jnp.zeros(NUM, jnp.int32),
        reserved_id=given["reserved"],
        doubts=SimpleNamespace(reason=jnp.full(NUM, Reason.UNCERTAIN_NEW)),
    )
    nothing, count = jnp.zeros(NUM), jnp.zeros(NUM, jnp.int32)
    views = jnp.stack([jnp.asarray(VIEWS)] * 2, axis=1)
    descriptors = Descriptors(
        appearance=views,
        appearance_valid=jnp.stack([seen] * 2, axis=1),
        parts=jnp.zeros((NUM, 1, static.switches.part_clusters, DIM), jnp.float32),
        parts_valid=jnp.zeros((NUM, 1, static.switches.part_clusters), bool),
        rings=jnp.zeros((NUM, 2, DIM), jnp.float32),
        rings_valid=jnp.zeros((NUM, 2), bool),
        num_patches=count,
        patch_sum=jnp.full(NUM, 99.0),
        num_parts=count,
        part_support=nothing,
        ring_patches=jnp.zeros((NUM, 2), jnp.int32),
        mask_quality=jnp.ones(NUM),
        class_id=given["class_id"],
        valid=seen,
        num_bad_patches=jnp.int32(0),
    )
    masks: Any = SimpleNamespace(center=jnp.zeros((NUM, 2)), area=jnp.full(NUM, 100.0))
    apart, never = jnp.zeros((NUM, NUM)), jnp.zeros((NUM, NUM), bool)
    relations = Relations(apart, apart, apart.astype(jnp.int32), apart, never, apart, never, never)
    alike = jnp.ones((NUM, PENDING))
    unsupported = jnp.full((NUM, NUM_OPTIONS), NO_SLOT)
    return remember(
        state, decisions, stages, settlement, unsupported, alike, descriptors, masks, relations,
        static, t,
    )  # fmt: skip


def frame(
    state: TrackerState,
    *outcomes: Outcome,
    slot=(),
    class_id=(),
    options=(),
    reserved=(),
    support=(),
) -> TrackerState:
    """Memory after a frame with these outcomes; what is left out is none, the class a cup."""

    def column(values, blank):
        return jnp.array([*values, *[blank] * (NUM - len(values))], jnp.int32)

    named = np.full((NUM, NUM_OPTIONS), NO_ID, np.int32)
    for n, ids in enumerate(options):
        named[n, : len(ids)] = ids
    given = {
        "outcome": column(outcomes, Outcome.EMPTY),
        "slot": column(slot, NO_SLOT),
        "class_id": column(class_id, CUP),
        "options": jnp.asarray(named),
        "reserved": column(reserved, NO_ID),
    }
    return jax.device_get(_remember(state, given, STATIC))


def two_cups() -> TrackerState:
    return frame(init(STATIC), Outcome.NEW, Outcome.NEW)


def looks(state: TrackerState, row: int) -> np.ndarray:
    """Prototypes of the whole look of an object, or, behind the objects, of a pending track."""
    work = state.appearance.work
    return np.asarray(work.embedding[0, row, : int(work.size[0, row])])


def test_new_objects_get_the_next_ids_and_slots_and_learn_their_look():
    after = frame(init(STATIC), Outcome.NEW, Outcome.NEW, class_id=(PLATE, CUP))
    assert after.objects.id.tolist() == [0, 1, NO_ID]
    assert after.objects.class_id.tolist() == [PLATE, CUP, NO_ID]
    assert after.objects.lifecycle[:2].tolist() == [Lifecycle.TENTATIVE] * 2
    assert after.decisions.object_id.tolist() == [0, 1, NO_ID]
    assert (int(after.next_id), int(after.frame)) == (2, 1)
    np.testing.assert_array_equal(looks(after, 0), VIEWS[:1])
    np.testing.assert_array_equal(looks(after, 1), VIEWS[1:2])
    assert len(looks(after, 2)) == 0
    assert after.cooccurrence.count[0, 1] == after.cooccurrence.count[1, 0] == 1


def test_what_is_seen_again_is_confirmed_and_what_is_not_misses_a_frame():
    before = two_cups()
    after = frame(before, Outcome.MATCH, slot=(1,))
    assert after.objects.hits.tolist() == [1, 2, 0]
    assert after.objects.misses.tolist() == [1, 0, 0]
    assert after.objects.age.tolist() == [2, 2, 0]
    assert after.objects.lifecycle[:2].tolist() == [Lifecycle.TENTATIVE, Lifecycle.CONFIRMED]
    # The first detection looks like axis 0, which the second object learns now.
    np.testing.assert_array_equal(looks(after, 1), VIEWS[[1, 0]])
    np.testing.assert_array_equal(looks(after, 0), looks(before, 0))


def test_an_object_of_two_detections_learns_both_looks():
    after = frame(two_cups(), Outcome.MATCH, Outcome.MATCH, Outcome.MATCH, slot=(0, 0, 0))
    assert after.objects.hits[0] == 4
    assert {tuple(row) for row in looks(after, 0)} == {tuple(row) for row in VIEWS}


def test_objects_that_an_undecided_detection_names_miss_nothing():
    after = frame(two_cups(), Outcome.AMBIGUOUS, options=((0, 1),))
    assert after.objects.misses.tolist() == [0, 0, 0]
    assert after.objects.hits.tolist() == [1, 1, 0]


def test_an_undecided_detection_is_remembered_by_its_track():
    opened = frame(two_cups(), Outcome.AMBIGUOUS, options=((0, 1),))
    assert opened.pending.kind.tolist() == [Kind.AMBIGUOUS, Kind.FREE]
    assert opened.decisions.pending_id.tolist() == [0, NO_ID, NO_ID]
    np.testing.assert_array_equal(looks(opened, SLOTS), VIEWS[:1])
    assert len(looks(opened, SLOTS + 1)) == 0
    again = frame(opened, Outcome.EMPTY, Outcome.AMBIGUOUS, options=((), (1, 0)))
    assert again.decisions.pending_id.tolist() == [NO_ID, 0, NO_ID]
    assert again.pending.hits[0] == opened.pending.hits[0] + 1
    np.testing.assert_array_equal(looks(again, SLOTS), VIEWS[:2])


def test_a_track_ends_with_its_banks_when_an_object_grows_out_of_it():
    opened = frame(init(STATIC), Outcome.PROVISIONAL_NEW)
    assert opened.pending.kind.tolist() == [Kind.PROVISIONAL, Kind.FREE]
    assert len(looks(opened, SLOTS)) == 1
    born = frame(opened, Outcome.EMPTY, Outcome.NEW)
    assert born.pending.kind.tolist() == [Kind.FREE, Kind.FREE]
    assert born.pending.id.tolist() == [NO_ID, NO_ID]
    assert len(looks(born, SLOTS)) == 0
    # The object starts with what founded it, not with what the track had seen.
    np.testing.assert_array_equal(looks(born, 0), VIEWS[1:2])


def test_an_ambiguous_detection_founds_the_object_reserved_for_it():
    """Id 2 is passed over: it was kept for a birth that the frame did not bring."""
    after = frame(two_cups(), Outcome.AMBIGUOUS, options=((0, 3),), reserved=(3,))
    assert after.objects.id.tolist() == [0, 1, 3]
    assert int(after.next_id) == 4
    assert after.decisions.object_id[0] == NO_ID
    assert after.pending.kind[0] == Kind.AMBIGUOUS
    # The object and the track both learn, one round each.
    np.testing.assert_array_equal(looks(after, 2), VIEWS[:1])
    np.testing.assert_array_equal(looks(after, SLOTS), VIEWS[:1])
    assert after.objects.misses.tolist() == [0, 1, 0]
    assert not after.cooccurrence.count[2].any()


@pytest.mark.parametrize("reserved", [1, 3])
def test_no_object_is_founded_under_an_id_that_is_taken_or_not_named(reserved):
    after = frame(two_cups(), Outcome.AMBIGUOUS, options=((0, 1),), reserved=(reserved,))
    assert after.objects.id.tolist() == [0, 1, NO_ID]
    assert int(after.next_id) == 2


def unchanged(after: TrackerState, before: TrackerState) -> None:
    """All of memory but `overflow` is as it was."""
    same = dataclasses.replace(after, overflow=before.overflow)
    jax.tree.map(np.testing.assert_array_equal, same, before)


def test_objects_that_do_not_fit_change_nothing():
    before = frame(two_cups(), Outcome.AMBIGUOUS, options=((0, 1),))
    after = frame(before, Outcome.NEW, Outcome.NEW, Outcome.MATCH, slot=(NO_SLOT, NO_SLOT, 0))
    assert (after.overflow.objects, after.overflow.pending) == (4, 0)
    unchanged(after, before)


def test_tracks_that_do_not_fit_change_nothing():
    before = frame(two_cups(), Outcome.AMBIGUOUS, options=((0, 1),))
    full = frame(before, Outcome.AMBIGUOUS, class_id=(PLATE,), options=((0, 1),))
    after = frame(full, Outcome.MATCH, Outcome.PROVISIONAL_NEW, slot=(0,))
    assert (after.overflow.objects, after.overflow.pending) == (0, 3)
    unchanged(after, full)


def test_gated_updates_learn_from_clear_matches_only():
    """method.md#update-permit: a weak match teaches nothing, an ambiguous one a little."""
    decisions = dataclasses.replace(no_decisions(STATIC), outcome=np.array([Outcome.MATCH] * 3))
    status = np.array([Status.STRONG, Status.AMBIGUOUS, Status.WEAK])
    stages: Any = SimpleNamespace(status_final=status)
    t = Thresholds(update=Update(gated=True, ambiguous_rate=0.25)).as_arrays(jnp.float32)
    learns, permit = gate_updates(decisions, stages, t)
    assert learns.tolist() == [True, True, False]
    assert permit.insert.tolist() == [True, False, True]
    assert permit.rate.tolist() == [1.0, 0.25, 1.0]
    free, permit = gate_updates(decisions, stages, Thresholds().as_arrays(jnp.float32))
    assert free.all()
    assert permit.insert.all()
