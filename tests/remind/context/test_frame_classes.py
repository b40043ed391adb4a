import functools

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.context.frame_classes import FrameClasses, group_by_class
from tests.statics import make_static

from .scenes import thresholds, view_of

NUM, SLOTS = 5, 7
SMALL = make_static(num_detections=NUM, num_objects=SLOTS, class_pool=3, class_detections=2)
LEAST = 0.125  # conditional probability from which an object speaks for another
LABELS = [-4, 0, 3]


_group = jax.jit(group_by_class, static_argnames="static")


def group(memory, detections, static=SMALL) -> FrameClasses:
    conditional, episodes, *objects = memory
    exists, object_class, anchors = objects
    view = view_of(
        conditional, episodes=episodes, exists=exists, object_class=object_class, anchors=anchors,
        detections=detections,
    )  # fmt: skip
    return jax.device_get(_group(view, static=static, t=_rules()))


@functools.cache
def _rules():
    return thresholds("float32", sets={"min_link": LEAST}).sets


def rank_plainly(objects, conditional, episodes, anchors):
    """method.md#frame-classes: objects of a class in the order in which they enter its pool."""
    said = {}
    for anchor in np.flatnonzero(anchors):
        for one in objects:
            told = conditional[anchor, one]
            if one != anchor and told >= LEAST and told > said.get(one, 0):
                said[one] = told
    first = [one for one in objects if anchors[one]]
    named = sorted(said, key=lambda one: -said[one])  # equals in the order of their first mention
    rest = sorted((one for one in objects if one not in said), key=lambda o: (-episodes[o], -o))
    return list(dict.fromkeys(first + named + rest))


def group_plainly(memory, detections, static):
    """Pairs (class, detections, pool) in the order of the search (method.md#frame-classes)."""
    conditional, episodes, exists, object_class, anchors = memory
    det_class, det_score, det_valid = detections
    classes = []
    for label in np.unique(det_class[det_valid]):
        objects = np.flatnonzero(exists & (object_class == label)).tolist()
        shown = np.flatnonzero(det_valid & (det_class == label)).tolist()
        if objects:
            pool = rank_plainly(objects, conditional, episodes, anchors)[
                : static.switches.class_pool
            ]
            shown.sort(key=lambda index: (det_score[index], index), reverse=True)
            classes.append(
                (shown[: static.switches.class_detections], sorted(pool, reverse=True), label)
            )
    return [entry[:2] for entry in sorted(classes, key=lambda entry: (len(entry[1]), entry[2]))]


def arrays(element, shape):
    size = int(np.prod(shape))
    numbers = st.lists(element, min_size=size, max_size=size)
    return numbers.map(lambda values: np.array(values).reshape(shape))


@st.composite
def frames(draw):
    """Few different values, so that most of them tie."""
    shares = st.sampled_from([0.0, 0.0, LEAST, 0.25, 0.5])
    exists = np.arange(SLOTS) < draw(st.integers(0, SLOTS))
    memory = (
        draw(arrays(shares, (SLOTS, SLOTS))).astype(np.float32) * (exists & exists[:, None]),
        draw(arrays(st.integers(0, 2), SLOTS)).astype(np.int32),
        exists,
        draw(arrays(st.sampled_from(LABELS), SLOTS)).astype(np.int32),
        draw(arrays(st.booleans(), SLOTS)) & exists,
    )
    detections = (
        draw(arrays(st.sampled_from([*LABELS, 9]), NUM)).astype(np.int32),
        draw(arrays(st.sampled_from([0.5, 1.0]), NUM)).astype(np.float32),
        draw(arrays(st.booleans(), NUM)),
    )
    return memory, detections


@given(frames())
def test_classes_come_as_by_a_plain_sort(frame):
    found = group(*frame)
    memory, detections = frame
    plain = group_plainly(memory, detections, SMALL)
    assert found.num == len(plain)
    for row, (shown, pool) in enumerate(plain):
        assert found.num_detections[row] == len(shown)
        assert found.pool_size[row] == len(pool)
        assert found.detections[row, : len(shown)].tolist() == shown
        assert found.pool[row, : len(pool)].tolist() == pool
        assert np.all(found.detections[row, len(shown) :] == NO_SLOT)
        assert np.all(found.pool[row, len(pool) :] == NO_SLOT)
    assert not np.any(found.pool_size[len(plain) :])


def memory_of(num: int, **changed):
    """`num` objects of class 0; who is expected by whom is told by `changed`."""
    slots = max(num, 1)
    memory = {
        "conditional": np.zeros((slots, slots), np.float32),
        "episodes": np.zeros(slots, np.int32),
        "exists": np.arange(slots) < num,
        "object_class": np.zeros(slots, np.int32),
        "anchors": np.zeros(slots, bool),
    }
    return tuple({**memory, **changed}.values())


def one_detection(label: int = 0, valid: bool = True):
    return np.array([label], np.int32), np.ones(1, np.float32), np.array([valid])


def test_large_class_keeps_25_objects():
    """The mature and late ones without anchors, the expected ones with them.

    Rule: method.md#frame-classes.
    """
    mature = np.zeros(30, np.int32)
    mature[[2, 11]] = 4
    found = group(memory_of(30, episodes=mature), one_detection(), make_static())
    assert found.pool_size[0] == 25
    assert set(found.pool[0, :25]) == {2} | set(range(6, 30))
    conditional = np.zeros((30, 30), np.float32)
    conditional[20, [0, 4]] = LEAST
    conditional[20, 5] = LEAST / 2
    memory = memory_of(30, conditional=conditional, episodes=mature, anchors=np.arange(30) == 20)
    found = group(memory, one_detection(), make_static())
    assert set(found.pool[0, :25]) == {0, 2, 4} | set(range(8, 30))
    np.testing.assert_array_equal(found.pool[0, :25], np.sort(found.pool[0, :25])[::-1])


@pytest.mark.parametrize(
    ("num", "detections"),
    [(0, one_detection()), (3, one_detection(label=1)), (3, one_detection(valid=False))],
)
def test_no_class_is_known(num, detections):
    found = group(memory_of(num), detections, make_static())
    assert found.num == 0
    assert not np.any(found.pool_size)
