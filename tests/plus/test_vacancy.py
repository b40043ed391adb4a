"""Empty places: what is decided tells where an object should be, and that it is not there."""

import jax
import numpy as np

from remind_jax.plus import vacancy
from remind_jax.plus.observation import Sightings
from remind_jax.plus.state import Pairs, init
from tests.plus.frames import T, detections
from tests.plus.walls import STATIC

ANCHORS = np.array([[2, 2], [4, 2], [3, 3.5]], np.float32)  # objects 0 to 2, where they are seen
PLACE = np.array([3, 2.3], np.float32)  # of object 3, which is not seen
SIZE = 0.5
find_gone = jax.jit(vacancy.find_gone)


def learned_pairs() -> Pairs:
    """Relations between objects 0 to 3, exactly as they lie."""
    where = np.concatenate([ANCHORS, PLACE[None]])
    offset = (where[None] - where[:, None]) / SIZE
    pairs = jax.tree.map(np.array, init(STATIC).pairs)
    pairs.relation[:4, :4], pairs.spread[:4, :4] = offset, 0.1
    return pairs


def seen(*more: tuple[float, float], anchors: np.ndarray = ANCHORS) -> Sightings:
    """The anchors, and detections that are not decided."""
    num, here = STATIC.num_detections, [*anchors, *more]
    center, valid = np.zeros((num, 2), np.float32), np.arange(num) < len(here)
    center[: len(here)] = here
    looks, size = np.zeros((num, STATIC.feature_dim)), np.full(num, SIZE, np.float32)
    return detections(center, looks, size=size, valid=valid)


def is_gone(sightings: Sightings, decided: tuple[int, ...] = (0, 1, 2)) -> bool:
    """Whether object 3 is told to be gone; the others never are, each stands at its place."""
    anchor = np.zeros(STATIC.num_detections, np.int32)
    anchor[: len(decided)] = decided
    is_anchor = np.arange(len(anchor)) < len(decided)
    gone = find_gone(anchor, is_anchor, sightings, learned_pairs(), T.layout)
    assert not np.any(gone[:3])
    assert not np.any(gone[4:]), "nothing is known of the place of these"
    return bool(gone[3])


def test_an_empty_place_in_view_is_seen():
    assert is_gone(seen())


def test_whatever_is_not_decided_there_may_be_the_object():
    assert not is_gone(seen(tuple(PLACE)))
    assert not is_gone(seen((PLACE[0] + 0.8 * SIZE, PLACE[1])))
    assert is_gone(seen((5.6, 4.2)))


def test_what_covers_the_place_hides_it():
    assert not is_gone(seen(tuple(PLACE + 0.1)), (0, 1, 2, 4))
    assert is_gone(seen((PLACE[0], PLACE[1] + 0.6 * SIZE)), (0, 1, 2, 4))


def test_two_anchors_are_too_few():
    assert not is_gone(seen(anchors=ANCHORS[:2]), (0, 1))


def test_a_place_at_the_border_is_not_in_view():
    assert not is_gone(seen(anchors=ANCHORS - (2.9, 0.0)))
