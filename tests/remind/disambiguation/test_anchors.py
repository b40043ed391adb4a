import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.disambiguation import anchors as rules
from remind_jax.remind.disambiguation.anchors import Group, Voters
from tests.statics import make_static

from .scenes import known_pairs, thresholds

pytestmark = pytest.mark.usefixtures("x64")
choose_anchors = jax.jit(rules.choose_anchors, static_argnums=3)
find_voters = jax.jit(rules.find_voters, static_argnums=6)


def pair_group(slots=(0, 1)):
    """Detections 0 and 1, each of which may be either object."""
    return Group(
        detection=np.array([0, 1]),
        is_detection=np.array([True, True]),
        candidate=np.array(slots),
        is_candidate=np.array([True, True]),
        slot=np.array(slots),
        stored=np.array([True, True]),
        allowed=np.ones((2, 2), bool),
    )  # pyright: ignore[reportArgumentType]


def voters(slots, factor=1.0):
    num = len(slots)
    return Voters(np.ones(num, bool), np.array(slots), np.arange(num), np.full(num, factor))  # pyright: ignore[reportArgumentType]


def choose(slots, quality, group=(0, 1), **changes):
    anchors = choose_anchors(
        pair_group(group),
        voters(slots),
        jnp.array(quality, jnp.float64),
        make_static(),
        thresholds(**changes),
    )
    found = np.flatnonzero(anchors.votes)
    return [(slots[anchors.voter[index]], int(anchors.votes[index])) for index in found]


@pytest.mark.parametrize(
    ("slots", "quality", "changes", "chosen"),
    [
        ([5, 6, 7, 8], [0.9, 0.8, 0.7, 0.6], {}, [(5, 1), (6, 1), (7, 1)]),
        ([5, 6, 7, 8], [0.9, 0.9, 0.9, 0.9], {}, [(8, 1), (7, 1), (6, 1)]),
        ([5, 6], [0.9, 0.53], {}, [(5, 1)]),
        ([5, 6], [0.9, 0.55], {}, [(5, 1), (6, 1)]),
        ([5, 6], [0.09, 0.08], {}, []),
        ([1, 6], [0.9, 0.2], {}, [(6, 1)]),  # candidates do not vote on themselves
        ([5, 6, 5, 7], [0.9, 0.8, 0.85, 0.7], {}, [(5, 2), (6, 1)]),
        ([5, 6, 7, 5], [0.9, 0.8, 0.7, 0.1], {}, [(5, 2), (6, 1), (7, 1)]),
        ([5, 6, 7], [0.9, 0.8, 0.7], {"max_anchors": 1}, [(5, 1)]),
        ([5, 6, 7], [0.9, 0.8, 0.7], {"max_pairs": 1}, [(5, 1), (6, 1)]),
    ],
)
def test_choice_of_anchors(slots, quality, changes, chosen):
    assert choose(slots, quality, **changes) == chosen


def find(known, matched_slot, *, undecided=(), matched_pass=None, eligible=None, soft_limit=4):
    known = np.array(known)
    num, num_objects = known.shape
    open_pairs = np.ones(known.shape, bool) if eligible is None else np.array(eligible)
    found = find_voters(
        np.isin(np.arange(num), undecided),
        np.array(matched_slot),
        np.zeros(num, np.int32) if matched_pass is None else np.array(matched_pass),
        np.ones(num_objects, bool),
        np.ones(known.shape, bool),
        known_pairs(known, open_pairs),
        make_static(soft_anchors=soft_limit),
        thresholds(),
    )
    found = jax.tree.map(lambda field: np.asarray(field)[np.asarray(found.valid)], found)
    return list(zip(found.slot.tolist(), found.place.tolist(), found.factor.tolist(), strict=True))


def test_ties_of_likely_objects():
    """The higher id among equal objects, the first among equal detections."""
    assert [entry[:2] for entry in find([[0.8, 0.8], [0.1, 0.8]], [-1, -1])] == [(1, 0)]
    ranked = find([[0.8, 0.0, 0.0], [0.0, 0.8, 0.0], [0.0, 0.0, 0.9]], [-1] * 3)
    assert [slot for slot, _, _ in ranked] == [2, 1, 0]
    assert [slot for slot, _, _ in find(np.eye(6), [-1] * 6)] == [5, 4, 3, 2]
    assert len(find(np.eye(6), [-1] * 6, soft_limit=0)) == 6
