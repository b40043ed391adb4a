"""Names of classes as evidence: what is confused, and what most detections say."""

import collections

import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.plus.class_names import confusion_odds, learn_names, name_odds, vote
from remind_jax.plus.static import NAME_ROWS
from tests.plus.frames import T, empty_state

CUP, BOTTLE, CHAIR = 0, 1, 2


def learn(scene, before, now, times):
    for _ in range(times):
        scene = learn_names(scene, jnp.array([before]), jnp.array([now]), jnp.ones(1))
    return scene


def odds_of(scene, left, right):
    both = name_odds(jnp.array([left]), jnp.array([right]), confusion_odds(scene, T.names))
    return float(both[0, 0])


def test_names_that_change_in_tracklets_say_little_and_those_that_never_do_say_more():
    scene = empty_state().scene
    assumed = odds_of(scene, CUP, CHAIR)
    assert np.isclose(assumed, np.log(T.names.confused), rtol=1e-5)  # float32
    for name in (CUP, BOTTLE, CHAIR):
        scene = learn(scene, name, name, 30)
    scene = learn(learn(scene, CUP, BOTTLE, 10), BOTTLE, CUP, 10)
    assert odds_of(scene, CUP, CHAIR) < assumed < odds_of(scene, CUP, BOTTLE) <= 0
    assert odds_of(scene, CUP, CUP) == 0
    assert odds_of(scene, CUP, BOTTLE) == odds_of(scene, BOTTLE, CUP)


def test_classes_that_share_a_row_are_not_taken_for_each_other_by_it():
    scene = learn(empty_state().scene, CUP, CUP, 50)
    assert odds_of(scene, CUP, CUP + NAME_ROWS) <= np.log(T.names.confused) + 1e-6
    assert learn(scene, CUP, CUP + NAME_ROWS, 9).names.sum() == scene.names.sum()


@given(st.lists(st.integers(0, 3), min_size=1, max_size=30))
def test_the_class_of_more_than_half_of_all_detections_wins(named):
    class_id, lead = jnp.array(named[:1]), jnp.ones(1, jnp.int32)
    for one in named[1:]:
        class_id, lead = vote(class_id, lead, jnp.array([one]), jnp.array([True]))
    most, times = collections.Counter(named).most_common(1)[0]
    assert int(class_id[0]) == most or 2 * times <= len(named)
    kept = vote(class_id, lead, class_id + 1, jnp.array([False]))
    assert [int(one[0]) for one in kept] == [int(class_id[0]), int(lead[0])]
