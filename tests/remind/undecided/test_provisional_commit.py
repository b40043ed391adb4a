"""When an undecided detection founds an object; `test_pending` has the tracks that end by it."""

import jax.numpy as jnp
import numpy as np

from remind_jax.numerics.absent import NO_ID
from remind_jax.remind.memory.objects import Objects
from remind_jax.remind.memory.pending import Items, Kind
from remind_jax.remind.undecided.provisional_commit import find_founders, found_reserved

SLOTS = 6


def objects_of(*ids, class_id=0) -> Objects:
    """Objects in the first slots."""
    column = np.full(SLOTS, NO_ID, np.int32)
    column[: len(ids)] = ids
    zero = jnp.zeros(SLOTS, jnp.int32)
    kind = jnp.where(jnp.asarray(column) != NO_ID, class_id, NO_ID)
    return Objects(jnp.asarray(column), kind, zero, zero, zero, zero, zero)


def items_of(kinds, known) -> Items:
    num = len(kinds)
    place = jnp.zeros((num, 2))
    return Items.begun(
        kind=jnp.array(kinds),
        class_id=jnp.zeros(num, jnp.int32),
        known_id=jnp.array(known),
        known_score=jnp.zeros((num, 3)),
        from_parent=jnp.zeros(num, bool),
        center=place,
        area=place[:, 0],
    )


def test_founders_stay_ambiguous_and_their_id_is_named_and_free():
    ambiguous, decided = int(Kind.AMBIGUOUS), int(Kind.FREE)
    reserved = jnp.array([7, NO_ID, 8, 9])
    named = [[0, 7, NO_ID], [0, 1, NO_ID], [0, 8, NO_ID], [0, 1, NO_ID]]
    founders = find_founders(reserved, items_of([ambiguous] * 4, named), jnp.int32(7))
    assert founders.tolist() == [True, False, True, False]  # nobody names 9
    taken = find_founders(reserved, items_of([ambiguous] * 4, named), jnp.int32(8))
    assert taken.tolist() == [False, False, True, False]
    settled = find_founders(reserved, items_of([decided] * 4, named), jnp.int32(7))
    assert not settled.any()


def test_reserved_objects_come_by_rising_id_and_ids_between_stay_unused():
    founds, reserved = jnp.array([True, False, True]), jnp.array([9, NO_ID, 6])
    classes = jnp.array([3, 4, 5])
    objects, slot, next_id = found_reserved(
        objects_of(0, 1), classes, founds, reserved, jnp.int32(5)
    )
    assert objects.id.tolist() == [0, 1, 6, 9, NO_ID, NO_ID]
    assert objects.class_id[2:4].tolist() == [5, 3]
    assert slot.tolist() == [3, SLOTS, 2]
    assert int(next_id) == 10
    same, _, next_id = found_reserved(
        objects_of(0, 1), classes, jnp.zeros(3, bool), reserved, jnp.int32(5)
    )
    assert same.id.tolist() == objects_of(0, 1).id.tolist()
    assert int(next_id) == 5
