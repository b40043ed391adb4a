"""One thing that a detector shows under two names, whole or under one of them cropped."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.decision import Outcome, Reason
from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.plus import linking
from remind_jax.plus.class_names import confusion_odds, learn_names, name_odds
from remind_jax.plus.cropping import cropped_overlap, find_cropped_doubles
from remind_jax.plus.thresholds import PlusThresholds
from tests.plus.frames import TICK, T, detections, empty_state, tracklets_of
from tests.plus.walls import Walk, follow, pan
from tests.statics import change_parts

CHAIR, SINK = 0, 1
UNLIKE = 1.5  # what a look loses that changed with the outline, log odds
WHOLE, TOP = [2.0, 1.0, 3.0, 3.0], [2.0, 1.0, 3.0, 1.6]


def test_boxes_are_one_where_both_are_cropped_at_one_side():
    boxes = np.array([WHOLE, TOP, [2, 2.4, 3, 3], [2, 1, 2.5, 1.6], [5, 5, 6, 6]], np.float32)
    found = cropped_overlap(boxes, boxes)
    np.testing.assert_allclose(found, found.T)
    # One side cropped; a corner; two sides, of which one may be: 0.6 by 0.6 of 2; apart.
    np.testing.assert_allclose(found[0], [1, 1, 1, 0.5, 0], atol=1e-6)


def _chair(box=TOP):
    """A chair that was seen, and what is seen in its place now: another look and box."""
    center = [[2.5, 2.0], [5, 4], [1, 4]]
    before = detections(center, box=np.array([WHOLE, [4, 4, 5, 5], [0, 4, 1, 5]], np.float32))
    look = np.eye(3, dtype=np.float32)[[1, 0, 2]]
    boxes = before.box.copy()
    boxes[0] = box
    now = dataclasses.replace(
        before, box=boxes, look=look, class_id=np.array([SINK, 0, 0], np.int32),
        valid=np.array([True, False, False]),
    )  # fmt: skip
    return before, now


@jax.jit
def _go_on(now, tracklets, names):
    odds = name_odds(now.class_id, tracklets.class_id, confusion_odds(empty_state().scene, names))
    unlike = odds - UNLIKE
    thresholds = dataclasses.replace(T, names=names)
    links = linking.score_links(tracklets, now, jnp.zeros((3, 8)), unlike, TICK, thresholds)
    origin = linking.link(links, T.linking)
    return origin[0], links.cropped.at(origin)[0]


def _link(now, tracklets, names=T.names):
    origin, is_cropped = _go_on(now, tracklets, names)
    return int(origin), bool(is_cropped)


def test_a_cropped_box_goes_on_under_another_name_where_the_tracklet_was_just_seen():
    before, now = _chair()
    tracklets = tracklets_of(before, 0, 8, last_class=np.full(8, CHAIR))
    assert _link(now, tracklets) == (0, True)
    unseen = dataclasses.replace(tracklets, unseen=np.full(8, 2.0, np.float32))
    assert _link(now, unseen) == (NO_SLOT, False)
    none = dataclasses.replace(T.names, cropped=jnp.float32(1.1))
    assert _link(now, tracklets, none) == (NO_SLOT, False)
    beside = _chair(box=[2.4, 1.0, 3.4, 1.6])[1]
    assert _link(beside, tracklets) == (NO_SLOT, False)


def test_what_another_detection_shows_is_left_out_once_its_name_was_seen_to_change():
    seen = detections(
        [[2.5, 2.0], [2.5, 1.3], [5, 4]],
        box=np.array([WHOLE, TOP, [4, 4, 5, 5]], np.float32),
        class_id=np.array([CHAIR, SINK, CHAIR], np.int32),
    )
    scene, origin = empty_state().scene, jnp.array([0, NO_SLOT, NO_SLOT])
    assumed = confusion_odds(scene, T.names)
    assert _doubles(seen, origin, assumed) == [NO_SLOT] * 3
    scene = learn_names(scene, jnp.array([SINK]), jnp.array([CHAIR]), jnp.ones(1))
    told = confusion_odds(scene, T.names)
    assert _doubles(seen, origin, told) == [NO_SLOT, 0, NO_SLOT]
    # Both go on with tracklets, or none does.
    assert _doubles(seen, jnp.array([0, 1, 2]), told) == [NO_SLOT] * 3
    assert _doubles(seen, jnp.full(3, NO_SLOT), told) == [NO_SLOT] * 3


def _doubles(seen, origin, confused, age=(5, 5, 5)):
    age = jnp.where(origin == NO_SLOT, 0, jnp.array(age))
    return find_cropped_doubles(seen, origin, age, confused, T.names).tolist()


def test_of_two_names_of_the_same_pixels_the_one_of_the_longer_tracklet_stays():
    center, looks = [[2.5, 2.0], [2.5, 2.0], [5, 4]], np.eye(3, dtype=np.float32)[[0, 0, 2]]
    names = np.array([CHAIR, SINK, CHAIR], np.int32)
    seen = detections(center, looks, class_id=names)
    assumed = confusion_odds(empty_state().scene, T.names)
    linked, none = jnp.array([0, 1, 2]), jnp.full(3, NO_SLOT)
    assert _doubles(seen, linked, assumed, (9, 3, 9)) == [NO_SLOT, 0, NO_SLOT]
    assert _doubles(seen, linked, assumed, (3, 9, 9)) == [1, NO_SLOT, NO_SLOT]
    assert _doubles(seen, jnp.array([NO_SLOT, 1, 2]), assumed) == [1, NO_SLOT, NO_SLOT]
    # Where neither was seen before, the first; of three, one.
    assert _doubles(seen, none, assumed) == [NO_SLOT, 0, NO_SLOT]
    thrice = dataclasses.replace(seen, class_id=np.arange(3), look=looks[[0, 0, 0]])
    thrice.box[2] = thrice.box[0]
    assert _doubles(thrice, none, assumed).count(NO_SLOT) == 1
    # Others: of one name, of other pixels in the same box, elsewhere, or where none is wanted.
    for other in (
        {"class_id": np.zeros(3, np.int32)},
        {"look": np.eye(3, dtype=np.float32)},
        {"size": np.array([1, 0.8, 1], np.float32)},
        {"box": seen.box + np.array([[0], [0.2], [0]], np.float32)},
    ):
        seen_otherwise = dataclasses.replace(seen, **other)
        assert _doubles(seen_otherwise, none, assumed) == [NO_SLOT] * 3
    none_wanted = dataclasses.replace(T.names, cropped=jnp.float32(1.1))
    assert (
        find_cropped_doubles(seen, none, jnp.zeros(3, int), assumed, none_wanted) == NO_SLOT
    ).all()


def _takes_turns() -> Walk:
    """A still camera; a thing whole in five frames, cropped in the next; both in two."""
    walk = pan()
    frame = jax.tree.map(lambda leaf: np.repeat(leaf[:1], 40, axis=0), walk.sightings)
    still = jax.tree.map(lambda leaf: np.repeat(leaf[:1], 40, axis=0), walk.motion)
    valid, shown = frame.valid.copy(), np.arange(40) // 5 % 2
    valid[:, 2:] = False
    valid[[7, 33], 2] = True
    for slot, is_top in ((0, shown), (2, 1 - shown)):
        top = is_top == 1
        frame.box[:, slot] = np.where(top[:, None], TOP, WHOLE)
        frame.center[:, slot] = np.where(top[:, None], (2.5, 1.3), (2.5, 2.0))
        frame.size[:, slot] = np.where(top, 0.77, 1.41)
        frame.class_id[:, slot] = np.where(top, SINK, CHAIR)
        frame.look[:, slot] = 3.0
        frame.look[np.arange(40), slot, is_top] += 2.0
    frame.box[:, 1], frame.center[:, 1] = [5, 3, 6, 4], [5.5, 3.5]
    noise = np.random.default_rng(0).normal(0, 0.1, frame.look.shape).astype(np.float32)
    sightings = dataclasses.replace(frame, valid=valid, look=frame.look + noise)
    return Walk(sightings, still, np.zeros((40, 6), int))


def test_boxes_that_take_turns_are_one_object_which_neither_moves_nor_changes_its_look():
    state, verdicts, decisions, _ = follow(_takes_turns())
    assert len(set(verdicts.answer_id[:, 0].tolist())) == 1
    assert int(state.objects.exists.sum()) == 2
    second = decisions.outcome[[7, 33], 2], decisions.reason[[7, 33], 2]
    assert np.all(second[0] == Outcome.DROPPED)
    assert np.all(second[1] == Reason.DOUBLE)
    assert (decisions.object_id[:, 2] == NO_ID).all()
    assert float(np.abs(state.tracklets.drift[0]).max()) < 0.01
    # Without, what changes its name is two objects.
    none = change_parts(PlusThresholds(), names={"cropped": 2.0})
    assert len(set(follow(_takes_turns(), none)[1].answer_id[:, 0].tolist())) == 2


def _named_twice() -> Walk:
    """A still camera; a thing that is shown under both names in most frames, else under one."""
    walk = _takes_turns()
    frame, shown = walk.sightings, np.arange(40) % 5
    frame.valid[:, 0], frame.valid[:, 2] = shown != 1, shown != 3
    for slot, name in ((0, CHAIR), (2, SINK)):
        frame.box[:, slot], frame.center[:, slot], frame.size[:, slot] = WHOLE, (2.5, 2.0), 1.41
        frame.class_id[:, slot], frame.look[:, slot] = name, frame.look[0, 0]
    return walk


def test_what_is_named_twice_is_one_object_and_teaches_both_names():
    walk = _named_twice()
    state, _, decisions, _ = follow(walk)
    shown = walk.sightings.valid[:, [0, 2]]
    is_double = decisions.reason[:, [0, 2]] == Reason.DOUBLE
    assert (is_double.sum(axis=1) == shown.all(axis=1)).all()
    assert len(set(decisions.object_id[:, [0, 2]][shown & ~is_double].tolist())) == 1
    assert int(state.objects.exists.sum()) == 2
    odds = name_odds(np.array([CHAIR]), np.array([SINK]), confusion_odds(state.scene, T.names))
    assert float(odds[0, 0]) > np.log(0.5)
    none = change_parts(PlusThresholds(), names={"cropped": 2.0})
    assert int(follow(_named_twice(), none)[0].objects.exists.sum()) == 3
