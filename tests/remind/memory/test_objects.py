import dataclasses

import jax
import jax.numpy as jnp
import pytest

from remind_jax.remind import state as memory
from remind_jax.remind.memory import objects as rows
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.state import init
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Lifecycle as Rules
from tests.statics import make_static

STATIC = make_static(num_objects=4, num_detections=3, num_pending=2, feature_dim=2)
create_objects, mark_seen = jax.jit(rows.create_objects), jax.jit(rows.mark_seen)
mark_missed, remove_objects = jax.jit(rows.mark_missed), jax.jit(memory.remove_objects)


def rules(**changes):
    return Thresholds(lifecycle=Rules(**changes)).as_arrays(jnp.float32).lifecycle


def born(*class_ids):
    """Objects created by one frame, in detection order."""
    ids = jnp.array([*class_ids, *[0] * (3 - len(class_ids))], jnp.int32)
    is_new = jnp.arange(3) < len(class_ids)
    return create_objects(init(STATIC).objects, ids, is_new, jnp.int32(0))


def standing(objects, slot=0):
    names = ("lifecycle", "hits", "misses", "age")
    state, *counts = (int(getattr(objects, name)[slot]) for name in names)
    return Lifecycle(state).name, *counts


def only(slot=0):
    return jnp.arange(STATIC.num_objects) == slot


def test_creation_takes_slots_and_ids_in_detection_order():
    objects, slot = create_objects(
        born(7)[0], jnp.array([1, 2, 3], jnp.int32), jnp.array([True, False, True]), jnp.int32(5)
    )
    assert slot.tolist() == [1, 4, 2]  # the second detection is not new
    assert objects.id.tolist() == [0, 5, 6, -1]
    assert objects.class_id.tolist()[:3] == [7, 1, 3]
    assert objects.exists.tolist() == [True, True, True, False]
    assert standing(objects, 1) == ("NEW", 0, 0, 0)


@pytest.mark.parametrize(
    ("state", "misses", "expected", "forgotten"),
    [
        ("TENTATIVE", 1, "TENTATIVE", False),
        ("TENTATIVE", 2, "TENTATIVE", True),
        ("CONFIRMED", 3, "CONFIRMED", False),
        ("CONFIRMED", 4, "INACTIVE", False),  # forgotten from the next frame on
        ("INACTIVE", 5, "INACTIVE", False),
        ("INACTIVE", 6, "INACTIVE", True),
    ],
)
def test_limits_of_absence(state, misses, expected, forgotten):
    t = rules(max_misses_tentative=2, max_misses_confirmed=4, max_misses_inactive=6)
    objects = dataclasses.replace(
        born(0)[0],
        lifecycle=jnp.full(4, Lifecycle[state], jnp.int32),
        misses=jnp.full(4, misses - 1, jnp.int32),
    )
    objects, gone = mark_missed(objects, only(), t)
    assert standing(objects)[0] == expected
    assert gone.tolist() == [forgotten, False, False, False]


def test_no_limit_is_zero():
    t = rules(max_misses_tentative=0, max_misses_confirmed=0, max_misses_inactive=0)
    for state in Lifecycle:
        objects = dataclasses.replace(
            born(0)[0],
            lifecycle=jnp.full(4, state, jnp.int32),
            misses=jnp.full(4, 999, jnp.int32),
        )
        objects, gone = mark_missed(objects, only(), t)
        assert not gone.any()
        assert standing(objects)[0] == ("TENTATIVE" if state == Lifecycle.NEW else state.name)


def test_removal_closes_gaps_and_takes_the_banks_along():
    state = init(STATIC)
    objects, _ = born(5, 6, 7)
    row = jnp.arange(state.wholes.size.shape[2])

    def number(banks):
        """Every row of every bank holds one prototype that says its row."""
        size = jnp.broadcast_to(jnp.int32(row < 3), banks.size.shape)
        counts = jnp.asarray(banks.counts).at[..., 0].set(row[:, None])  # of hits
        return dataclasses.replace(banks, size=size, counts=counts)

    state = dataclasses.replace(
        state,
        objects=objects,
        next_id=jnp.int32(3),
        wholes=number(state.wholes),
        parts=number(state.parts),
    )
    left = remove_objects(state, only(1))
    assert left.objects.id.tolist() == [0, 2, -1, -1]
    assert left.objects.class_id.tolist()[:2] == [5, 7]
    assert int(left.next_id) == 3  # ids are not used again
    for banks in (left.wholes, left.parts):
        assert (banks.size[..., :4] == jnp.array([1, 1, 0, 0])).all()
        assert (banks.hits[..., :2, 0] == jnp.array([0, 2])).all()
    again, slot = create_objects(
        left.objects, jnp.array([9, 9, 9], jnp.int32), jnp.array([True, False, False]), left.next_id
    )
    assert again.id.tolist() == [0, 2, 3, -1]
    assert slot[0] == 2
    assert standing(again, 2) == ("NEW", 0, 0, 0)
