"""Two of one class that pass behind each other."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.plus.crossing import course_odds
from tests.plus.frames import detections, go_on, tracklets_of
from tests.plus.walls import NO_TRUTH, Walk, follow, pan

FRAMES, MEETING, SIZE = 50, 24, 0.5
PACE = 0.06
ROOM = 8


def _two_people(*, in_front: int, turn_back: bool, looks: tuple[int, int], seed: int = 0) -> Walk:
    """A still camera; two walk towards each other, one is hidden for a while, both walk on.

    Args:
      in_front: Which of them hides the other.
      turn_back: They go back where they came from.
      looks: Direction of the look of each.
      seed: Of what varies in their looks.
    """
    walk, ticks = pan(), np.arange(FRAMES)
    frame, motion = jax.tree.map(
        lambda leaf: np.repeat(leaf[:1], FRAMES, axis=0), (walk.sightings, walk.motion)
    )
    away = PACE * (ticks - MEETING)
    away = -np.abs(away) if turn_back else away
    middle = 3.0 + np.stack([away, -away], axis=1)
    hidden = np.abs(away) < 0.4 * SIZE
    valid = np.zeros_like(frame.valid)
    valid[:, :2] = True
    valid[hidden, 1 - in_front] = False
    rng = np.random.default_rng(seed)
    for person in range(2):
        # Of both, when one hides the other, there is one box.
        left, right = middle[:, person] - SIZE / 2, middle[:, person] + SIZE / 2
        left = np.where(hidden, middle.min(axis=1) - SIZE / 2, left)
        right = np.where(hidden, middle.max(axis=1) + SIZE / 2, right)
        frame.box[:, person] = np.stack([left, 0 * left + 1.0, right, 0 * left + 2.5], axis=1)
        frame.center[:, person] = np.stack([(left + right) / 2, 0 * left + 1.75], axis=1)
        frame.size[:, person] = 0.8
        frame.look[:, person] = rng.normal(3.0, 0.1, frame.look[:, person].shape)
        frame.look[:, person, looks[person]] += 2.0
    sightings = dataclasses.replace(frame, valid=valid)
    return Walk(sightings, motion, np.full((FRAMES, 6), NO_TRUTH))


@pytest.mark.parametrize("in_front", [0, 1])
@pytest.mark.parametrize("turn_back", [False, True])
def test_each_comes_out_as_it_went_in(in_front, turn_back):
    walk = _two_people(in_front=in_front, turn_back=turn_back, looks=(0, 1))
    answer = follow(walk)[1].answer_id[:, :2]
    assert answer[MEETING - 6].tolist() == answer[-1].tolist() == [0, 1]


@pytest.mark.parametrize("in_front", [0, 1])
@pytest.mark.parametrize("seed", range(8))
def test_who_looks_the_same_is_not_taken_for_the_other(in_front, seed):
    walk = _two_people(in_front=in_front, turn_back=False, looks=(0, 0), seed=seed)
    answer = follow(walk)[1].answer_id[:, :2]
    assert answer[MEETING - 6].tolist() == [0, 1]
    assert answer[-1, 0] != 1
    assert answer[-1, 1] != 0


def _meeting(age: int = 10):
    """Two that were seen for long, of which one is not seen now, with paces of one direction."""
    before = detections([[1, 1], [1.5, 1], [5, 5]])
    tracklets = tracklets_of(
        before, 0, ROOM, num_moves=np.full(ROOM, float(age), np.float32),
        pace=np.full((ROOM, 2), 0.1, np.float32), course=np.full((ROOM, 2), 1.0, np.float32),
    )  # fmt: skip
    return dataclasses.replace(before, valid=np.array([True, False, True])), tracklets


def test_two_meet_where_one_is_missed_under_the_box_of_the_other():
    now, tracklets = _meeting()
    after, _, _ = go_on(tracklets, now, [0, NO_SLOT, 2], 1)
    rows = [after.id.tolist().index(one) for one in (0, 1, 2)]
    assert after.met[jnp.array(rows)].tolist() == [1.0, 1.0, 0.0]
    assert after.met_id[jnp.array(rows)].tolist() == [1, 0, NO_ID]
    # The course goes on as it was, that of the third is where it is.
    np.testing.assert_allclose(after.course[jnp.array(rows)], [[1, 1], [1, 1], [5, 5]])
    apart, _, _ = go_on(tracklets, detections([[1, 1], [1.5, 1], [5, 5]]), [0, 1, 2], 1)
    assert not apart.met.any()
    unknown, _, _ = go_on(_meeting(age=1)[1], now, [0, NO_SLOT, 2], 1)
    assert not unknown.met.any()


def test_a_pace_is_learned_by_the_time_that_a_course_went_on():
    """Nine ticks long it met another one, and fell behind its course by one unit."""
    _, tracklets = _meeting()
    met = np.array([9.0] + [0.0] * (ROOM - 1), np.float32)
    course = np.array([[2.0, 1.0]] + [[5.0, 5.0]] * (ROOM - 1), np.float32)
    tracklets = dataclasses.replace(tracklets, met=met, course=course, age=np.full(ROOM, 2))
    apart, _, _ = go_on(tracklets, detections([[1, 1], [1.5, 1], [5, 5]]), [0, 1, 2], 1)
    np.testing.assert_allclose(apart.met, 0.0)
    np.testing.assert_allclose(apart.pace[0], [0.1 - 1.0 / 9.0 / 2.0, 0.1], rtol=1e-5)


def test_only_another_one_that_met_and_fits_better_speaks_against_a_link():
    _, tracklets = _meeting()
    course = np.array([[1.0, 1.0], [3.0, 1.0]] + [[0.0, 0.0]] * (ROOM - 2), np.float32)
    met = np.array([4.0, 4.0] + [0.0] * (ROOM - 2), np.float32)
    met_two = dataclasses.replace(tracklets, course=course, met=met)
    odds = course_odds(met_two, detections([[1, 1], [3, 1], [2, 9]]).box)
    assert odds[0, 0] == odds[1, 1] == 0.0
    assert odds[0, 1] < -3.0
    assert odds[1, 0] < -3.0
    # Both are as far away.
    np.testing.assert_allclose(odds[2, :2], 0.0, atol=1e-5)
    assert not odds[:, 2:].any()
