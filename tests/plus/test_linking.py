"""Which detection goes on with which tracklet, and what becomes of tracklets."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.plus import linking
from remind_jax.plus.class_names import confusion_odds, name_odds
from tests.plus.frames import TICK, T, detections, empty_state, go_on, motion, tracklets_of

ROOM = 8
SCENE = empty_state().scene
carry = jax.jit(linking.carry)


@jax.jit
def join(seen, tracklets, cosine=np.ones((3, ROOM), np.float32)):  # noqa: B008
    names = name_odds(seen.class_id, tracklets.class_id, confusion_odds(SCENE, T.names))
    links = linking.score_links(tracklets, seen, cosine, names, TICK, T)
    return linking.link(links, T.linking)


def test_detections_go_on_with_the_tracklets_where_they_lie():
    before = detections([[1, 1], [4, 1], [1, 4]])
    now = detections([[4.1, 1], [1, 4.1], [1.1, 1]])
    assert join(now, tracklets_of(before, 0, ROOM)).tolist() == [1, 2, 0]


def test_nothing_goes_on_far_away_or_with_another_class_and_look():
    tracklets = tracklets_of(detections([[1, 1], [4, 1], [1, 4]]), 0, ROOM)
    far = detections([[6, 4], [4, 1], [1, 4]])
    assert join(far, tracklets, cosine=jnp.zeros((3, ROOM))).tolist() == [NO_SLOT, 1, 2]
    other = detections([[1, 1], [4, 1], [1, 4]], class_id=jnp.array([1, 0, 0]))
    unlike = jnp.ones((3, ROOM)).at[0, 0].set(-1.0)
    assert join(other, tracklets, cosine=unlike).tolist() == [NO_SLOT, 1, 2]


def test_what_lies_and_looks_alike_goes_on_under_another_class_unless_one_of_its_class_is_there():
    tracklets = tracklets_of(detections([[1, 1], [4, 1], [1, 4]]), 0, ROOM)
    renamed = detections([[1, 1], [4, 1], [1, 4]], class_id=jnp.array([1, 0, 0]))
    assert join(renamed, tracklets).tolist() == [0, 1, 2]
    beside = detections([[1, 1], [1.05, 1], [1, 4]], class_id=jnp.array([1, 0, 0]))
    assert join(beside, tracklets).tolist() == [NO_SLOT, 0, 2]


def test_looks_decide_where_two_lie_alike():
    tracklets = tracklets_of(detections([[2, 2], [2.5, 2], [5, 4]]), 0, ROOM)
    now = detections([[2.25, 2], [2.25, 2], [5, 4]])
    alike = jnp.zeros((3, ROOM)).at[0, 1].set(1).at[1, 0].set(1)
    assert join(now, tracklets, cosine=alike).tolist() == [1, 0, 2]


@jax.jit
def trust(seen, tracklets, origin):
    odds = jnp.zeros((3, ROOM))
    links = linking.score_links(tracklets, seen, odds + 1, odds, TICK, T)
    return linking.trust_links(links, origin, T.linking)


def test_links_are_trusted_as_far_as_no_other_tracklet_could_go_on_there():
    apart = detections([[1, 1], [4, 1], [1, 4]])
    origin = jnp.array([0, 1, 2])
    # Far apart no doubt adds up in a thousand frames.
    for found in trust(apart, tracklets_of(apart, 0, ROOM), origin):
        np.testing.assert_allclose(found, 1.0, atol=1e-6)
    crossing = detections([[1, 1], [1, 1], [1, 4]])
    found, _ = trust(crossing, tracklets_of(crossing, 0, ROOM), origin)
    np.testing.assert_allclose(found, [0.5, 0.5, 1.0], atol=1e-6)
    # One of both is covered: the other may be either, the less the farther it is.
    covered = dataclasses.replace(crossing, valid=jnp.array([True, False, True]))
    alone = jnp.array([0, NO_SLOT, 2])
    found, waiting = trust(covered, tracklets_of(crossing, 0, ROOM), alone)
    np.testing.assert_allclose(found, [0.5, 1.0, 1.0], atol=1e-3)
    # What waits is as doubtful: its thing may be what went on with the other.
    np.testing.assert_allclose(waiting[:3], [1.0, 0.5, 1.0], atol=1e-3)
    beside = tracklets_of(detections([[1, 1], [1.5, 1], [1, 4]]), 0, ROOM)
    found, waiting = trust(covered, beside, alone)
    assert 0.5 < found[0] < 1.0
    np.testing.assert_allclose(found[0], waiting[1], atol=1e-3)
    for one in trust(covered, beside, jnp.full(3, NO_SLOT)):
        assert (one == 1).all()


def test_tracklets_are_carried_along_with_shift_and_zoom():
    tracklets = tracklets_of(detections([[1, 1], [2, 2], [3, 3]]), 0, ROOM)
    zoomed = dataclasses.replace(motion(), matrix=jnp.array([[2.0, 0, 1], [0, 2.0, 0]]))
    carried = carry(tracklets, zoomed, T.mobility)
    np.testing.assert_allclose(carried.center[0], [3, 2])
    np.testing.assert_allclose(carried.box[0], [2, 1, 4, 3])  # twice as large around it
    still = carry(tracklets, motion(), T.mobility)
    np.testing.assert_allclose(still.box, tracklets.box)


def test_looks_are_smoothed_and_new_tracklets_are_numbered():
    before = detections([[1, 1], [4, 1], [1, 4]])
    tracklets = tracklets_of(before, 0, ROOM)
    now = dataclasses.replace(before, look=before.look + 1.0)
    after, next_id, step = go_on(tracklets, now, [0, NO_SLOT, 2], 1, next_id=7)
    assert after.age[:3].tolist() == [2, 1, 2]
    assert after.id[:3].tolist() == [0, 7, 2]
    assert next_id == 8
    np.testing.assert_allclose(after.look[0], before.look[0] + 0.5)  # mean of both
    np.testing.assert_allclose(after.look[1], now.look[1])
    np.testing.assert_allclose(after.first_look[0], before.look[0])
    np.testing.assert_allclose(step[0], 1.0)


@pytest.mark.parametrize(("missed", "waits"), [(7, True), (8, False)])
def test_a_missed_tracklet_may_resume_for_some_ticks(missed, waits):
    unseen = jnp.full(ROOM, float(missed))
    tracklets = tracklets_of(detections([[1, 1], [4, 1], [1, 4]]), 0, ROOM, unseen=unseen)
    nothing = detections([[0, 0]] * 3, valid=jnp.zeros(3, bool))
    after, _, _ = go_on(tracklets, nothing, [NO_SLOT] * 3, missed + 1)
    assert bool(after.alive.any()) == waits
    assert not after.alive[:3].any()  # the first rows are those of the frame


def test_looks_less_alike_than_others_are_no_more_like_the_same():
    scene = empty_state().scene
    cosines = jnp.linspace(-1, 1, 41)[None]
    whole, cut = (
        linking.link_odds(cosines, jnp.full((1, 41), border), scene, T.calibration)[0]
        for border in (False, True)
    )
    assert (jnp.diff(whole) >= 0).all()
    assert whole[0] < -3.0
    assert whole[-1] > 2.0, "as alike as links are"
    assert (whole[:20] < cut[:20]).all(), "the border changes looks"


def test_looks_tell_less_where_all_in_view_look_alike():
    """However alike looks are in two frames: those of two objects are as much."""
    seen = detections([[1, 1], [4, 1], [1, 4]])
    before = tracklets_of(seen, 0, ROOM)
    nothing = jnp.zeros((3, ROOM), bool)
    odds = []
    for apart in (0.0, 0.9):
        scene = empty_state().scene
        for _ in range(20):
            scene = linking.learn_apart(scene, before, jnp.full((3, 3), apart), jnp.array(True))
            weight = jnp.ones(3)
            likeness = jnp.full((3, ROOM), 0.9)
            scene = linking.learn_links(scene, before, likeness, jnp.arange(3), weight)
        cosine = jnp.full((3, ROOM), 0.0)
        odds.append(float(linking.link_odds(cosine, nothing, scene, T.calibration)[0, 0]))
    assert odds[0] < -6.0
    assert odds[1] > odds[0] + 3.0
    between = linking.learn_apart(scene, before, jnp.ones((3, 3)), jnp.array(False))
    assert (between.apart == scene.apart).all(), "between ticks nothing teaches"


def test_what_looks_kept_apart_teaches_as_far_as_it_was_likely():
    seen = detections([[1, 1], [4, 1], [1, 4]])
    before = tracklets_of(seen, 0, ROOM)
    unlike = jnp.full((3, ROOM), -3.0).at[1].set(-9.0).at[2].set(0.0)
    links = linking.score_links(before, seen, jnp.zeros((3, ROOM)), unlike, TICK, T)
    origin = linking.link(links, T.linking)
    assert origin.tolist() == [0, NO_SLOT, 2]
    partner, chance = linking.likely_partners(links, before.alive, origin, T.linking)
    assert partner.tolist() == [0, 1, 2]
    assert chance[0] == chance[2] == 1.0
    assert 0.0 < chance[1] < 0.01
    # Behind those that wait, the table holds what others were a frame ago.
    gone = dataclasses.replace(links, score=links.score.at[:, 3].set(9.0))
    assert linking.likely_partners(gone, before.alive, origin, T.linking)[0].tolist() == [0, 1, 2]


def test_what_looks_alike_makes_no_link_possible():
    seen = detections([[1, 1], [4, 1], [1, 4]])
    before, nothing = tracklets_of(seen, 0, ROOM), jnp.zeros((3, ROOM))
    links = linking.score_links(before, seen, nothing, nothing, TICK, T)
    against = jnp.zeros((3, ROOM)).at[0, 0].set(-8.0)
    alike = links.with_odds(against, jnp.full((3, ROOM), 10.0), T.linking)
    alone = links.with_odds(against, nothing, T.linking)
    assert alike.possible.tolist() == alone.possible.tolist()
    assert not alike.possible[0, 0]
    np.testing.assert_allclose(
        alike.score, jnp.where(alone.possible, alone.score + 10.0, alone.score)
    )


def test_backgrounds_link_nothing():
    """Whoever passes one spot has one background."""
    state, is_background = empty_state(), np.array([False, False, True])
    scene = dataclasses.replace(state.scene, whitener=jnp.eye(3), white_mean=jnp.zeros(3))
    looks = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    behind = np.array([[0.0, 0.0, 9.0], [0.0, 0.0, 9.0], [0.0, 0.0, -9.0]])
    before = tracklets_of(detections([[1, 1], [2, 1], [3, 1]], looks + behind), 0, ROOM)
    now = detections([[1, 1], [2, 1], [3, 1]], looks - behind, is_background=is_background)
    cosine = jax.jit(linking.compare_looks)(before, now, scene)[0][:, :3]
    np.testing.assert_allclose(cosine, looks @ looks.T, atol=1e-6)


def test_over_a_cut_the_fewer_go_on_the_less_one_of_them_does():
    seen = detections([[1, 1], [4, 1], [1, 4], [4, 4]])
    tracklets = tracklets_of(seen, 0, ROOM)
    unlike = jnp.full((4, len(tracklets.alive)), -8.0)
    share = [
        float(linking.cut_odds(unlike.at[:going, 0].set(0.0), tracklets, seen))
        for going in range(5)
    ]
    np.testing.assert_allclose(share, np.log([0.5 / 4.5, 1.5 / 3.5, 1, 1, 1]), atol=0.01)
    empty = dataclasses.replace(seen, valid=jnp.zeros(4, bool))
    assert linking.cut_odds(unlike, tracklets, empty) == 0.0
