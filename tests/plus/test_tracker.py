"""The whole step: who is who along a wall, and what must never happen."""

import dataclasses
import functools
import operator

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.decision import Outcome
from remind_jax.method import get_method
from remind_jax.numerics.absent import NO_ID
from remind_jax.plus.state import init
from remind_jax.plus.thresholds import PlusThresholds
from tests.plus.walls import (
    BLOCK,
    NO_TRUTH,
    STATIC,
    Walk,
    displace,
    follow,
    glimpse,
    pan,
    scan_block,
    split,
)
from tests.statics import change_parts

PUBLISHED = PlusThresholds()
PLACELESS = change_parts(
    PUBLISHED, place={"weight": 0.0}, layout={"weight": 0.0, "covisible_weight": 0.0}
)


def share_right(thing: np.ndarray, answer: np.ndarray) -> float:
    """Share of detections that carry the id that their thing carries most often."""
    known = thing != NO_TRUTH
    pairs = list(zip(thing[known], answer[known], strict=True))
    right = 0
    for one in np.unique(thing[known]):
        ids = [answer for truth, answer in pairs if truth == one]
        right += np.max(np.unique(ids, return_counts=True)[1])
    return right / len(pairs)


def num_repeated(ids: np.ndarray) -> int:
    """Ids that are given more than once within a frame."""
    told = [frame[frame != NO_ID] for frame in ids]
    return sum(len(frame) - len(np.unique(frame)) for frame in told)


def test_things_get_their_identity_back_after_an_absence():
    walk = pan()
    _, verdicts, _, _ = follow(walk)
    assert share_right(walk.thing, verdicts.answer_id) > 0.97
    assert len(np.unique(verdicts.answer_id[walk.thing != NO_TRUTH])) <= 12


def test_what_a_fast_camera_shows_counts_by_the_clock():
    slow, fast = pan(), pan(frames=270)
    timed = change_parts(fast, motion={"elapsed": np.full(270, 1 / 3, np.float32)})
    by_clock, verdicts, _, _ = follow(timed)
    seen, seen_by_clock, seen_by_frame = (
        float(jnp.sum(state.objects.seen)) for state in (follow(slow)[0], by_clock, follow(fast)[0])
    )
    assert share_right(fast.thing, verdicts.answer_id) > 0.97
    assert by_clock.ticks == 90
    assert seen_by_clock == pytest.approx(seen, rel=0.1)
    assert seen_by_frame > 2 * seen


def test_a_slow_camera_takes_half_the_detections_to_decide():
    walk = pan()
    seldom = change_parts(walk, motion={"elapsed": np.full(90, 10.0, np.float32)})
    decided = [follow(one)[1].is_decided[:, 0] for one in (walk, seldom)]
    assert [int(np.argmax(one)) for one in decided] == [7, 3]


def test_place_tells_apart_what_looks_the_same():
    walk = pan(alike=True)
    _, verdicts, _, _ = follow(walk)
    _, without, _, _ = follow(walk, PLACELESS)
    assert share_right(walk.thing, verdicts.answer_id) > 0.9
    assert share_right(walk.thing, without.answer_id) < 0.8


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("alike", [False, True])
def test_no_identity_is_given_twice_in_a_frame_at_thirty_percent_loss(seed, alike):
    walk = pan(seed, lost=0.3, alike=alike)
    _, verdicts, decisions, _ = follow(walk)
    assert num_repeated(verdicts.answer_id) == 0
    assert num_repeated(decisions.object_id) == 0


def test_what_ended_before_it_was_decided_is_known_at_its_next_sight():
    """Three frames of a thing that nobody saw before, and three when the camera is back."""
    walk, thing = pan(), 4
    passes = np.flatnonzero(np.any(walk.thing == thing, axis=1))
    first, second = passes[3:6], passes[-6:-3]
    assert second[0] - first[-1] > 20
    brief = glimpse(walk, thing, np.concatenate([first, second]))
    remembering, forgetting = (
        follow(brief, change_parts(PUBLISHED, decision={"ended_age": age}))[1].answer_id
        for age in (2, 0)
    )
    seen = brief.thing == thing
    before, after = first[-1], second[-1]
    assert remembering[after][seen[after]] == remembering[before][seen[before]]
    assert forgetting[after][seen[after]] != forgetting[before][seen[before]]


@pytest.mark.parametrize("held", [0.0, 3.0])
def test_no_object_belongs_to_two_tracklets(held):
    walk = pan(3, lost=0.4, alike=True)
    thresholds = change_parts(PUBLISHED, decision={"held": held})
    state, verdicts, _, _ = follow(walk, thresholds)
    slots = np.asarray(state.tracklets.slot)[np.asarray(state.tracklets.alive)]
    slots = slots[slots >= 0]
    assert len(slots) == len(np.unique(slots)) > 0
    assert num_repeated(verdicts.answer_id) == 0


def test_place_says_less_against_a_thing_whose_old_place_is_seen_to_be_empty():
    thing, away = 3, 40
    walk = displace(pan(), thing, away, (0.2, 2.4))
    moved = (walk.thing == thing) & (np.arange(len(walk.thing)) >= away)[:, None]

    def given_back(gone: float) -> np.ndarray:
        """What the moved thing gets back while it is not decided, as the thing that it is."""
        _, told, _, _ = follow(walk, change_parts(PUBLISHED, layout={"moved_gone": gone}))
        itself = told.option_id[moved] == told.answer_id[walk.thing == thing][0]
        return told.evidence.moved[moved][itself]

    assert np.max(given_back(-3.0)) < 0.5, "it hardly lies wrong by more than that"
    assert np.max(given_back(-0.5)) > 2.0


def test_a_thing_whose_tracklet_went_with_half_of_it_keeps_its_identity():
    frame, thing = 15, 4
    walk = split(pan(), thing, frame)
    _, verdicts, _, _ = follow(walk)
    _, held, _, _ = follow(walk, change_parts(PUBLISHED, decision={"held": 100.0}))
    before = verdicts.answer_id[frame - 1][walk.thing[frame - 1] == thing]
    after = walk.thing[frame + 1] == thing
    assert verdicts.answer_id[frame + 1][after] == before
    assert held.answer_id[frame + 1][after] != before
    assert num_repeated(verdicts.answer_id) == 0


def test_a_lying_image_motion_is_found_out():
    walk = pan()
    rng = np.random.default_rng(0)
    matrix = walk.motion.matrix.copy()
    lies = rng.random(len(matrix)) < 0.15
    matrix[lies, :, 2] += rng.choice([-1, 1], (int(lies.sum()), 2)) * 1.5
    lied = change_parts(walk, motion={"matrix": matrix})
    _, checked, _, _ = follow(lied)
    _, trusting, _, _ = follow(lied, change_parts(PUBLISHED, motion={"checked": False}))
    believed = share_right(walk.thing, trusting.answer_id)
    assert share_right(walk.thing, checked.answer_id) > max(0.95, believed + 0.05)


def test_capacities_change_nothing_and_may_grow_at_any_frame():
    """Frames that miss things surround the cuts: their tracklets wait and resume in more room."""
    walk = pan(1, lost=0.3)
    _, expected, decisions, _ = follow(walk)
    num = STATIC.num_detections
    wide = dataclasses.replace(STATIC, num_detections=num + 1, num_objects=40)
    _, verdicts, outcomes, _ = follow(widened(walk), static=wide)
    assert np.array_equal(verdicts.answer_id[:, :num], expected.answer_id)
    assert np.array_equal(outcomes.outcome[:, :num], decisions.outcome)
    for cut in range(30, 50, BLOCK):
        first, second = (
            Walk(*jax.tree.map(operator.itemgetter(p), (walk.sightings, walk.motion, walk.thing)))
            for p in (np.s_[:cut], np.s_[cut:])
        )
        state, before, _, _ = follow(first)
        state = get_method("plus").enlarge(jax.device_get(state), wide)
        _, after, _, _ = follow(widened(second), static=wide, state=state)
        told = np.concatenate([before.answer_id, after.answer_id[:, :num]])
        assert np.array_equal(told, expected.answer_id), cut


def widened(walk: Walk) -> Walk:
    """With one more slot of detections, empty."""
    num = walk.thing.shape[1]

    def widen(leaf: np.ndarray) -> np.ndarray:
        if leaf.ndim < 2 or leaf.shape[1] != num:
            return leaf
        return np.concatenate([leaf, np.zeros_like(leaf[:, :1])], axis=1)

    wide = jax.tree.map(widen, walk.sightings)
    of_channels = ("is_background", "light_changes")
    wide = dataclasses.replace(
        wide, **{name: getattr(walk.sightings, name) for name in of_channels}
    )
    return Walk(wide, walk.motion, widen(walk.thing))


def test_too_few_slots_are_flagged_and_change_nothing_else():
    state, _, _, overflow = follow(pan(num_things=40))
    full = np.flatnonzero(overflow.objects)
    assert full.size
    assert overflow.objects[full[0]] > STATIC.num_objects
    assert int(state.frame) == len(overflow.objects) - len(full)  # a frame that overflows is none
    assert np.all(overflow.pending == 0)


@pytest.mark.slow
def test_a_batch_of_walks_is_followed_like_each_of_them():
    walks = [pan(seed) for seed in (0, 1)]
    both = jax.tree.map(
        lambda *leaves: jnp.stack(leaves), *((walk.sightings, walk.motion) for walk in walks)
    )
    together = jax.device_get(jax.jit(jax.vmap(answers_of))(both))
    for index, walk in enumerate(walks):
        assert np.array_equal(together[index], follow(walk)[1].answer_id)


def answers_of(pair):
    return scan_block(init(STATIC), pair, PlusThresholds(), STATIC)[1][0].answer_id


def test_open_tracklets_are_told_as_what_they_are():
    walk = pan(2, alike=True)
    _, verdicts, decisions, _ = follow(walk)
    seen = walk.thing != NO_TRUTH
    undecided = np.isin(decisions.outcome, [Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT])
    assert np.all(decisions.outcome[~seen] == Outcome.EMPTY)
    assert np.all((decisions.object_id == NO_ID)[seen] == undecided[seen])
    assert np.all(decisions.option_id[undecided][:, 0] == verdicts.answer_id[undecided])
    assert np.all(decisions.pending_id[undecided] == verdicts.tracklet_id[undecided])
    assert np.all((decisions.confidence >= 0) & (decisions.confidence <= 1))
    new = decisions.outcome == Outcome.NEW
    ids = decisions.object_id[new]
    assert len(ids) == len(np.unique(ids))  # an id is new once


def test_an_empty_frame_is_survived():
    walk = pan()
    valid = walk.sightings.valid.copy()
    valid[8:11] = False
    _, verdicts, _, _ = follow(change_parts(walk, sightings={"valid": valid, "has_ring": valid}))
    before, after = verdicts.answer_id[7], verdicts.answer_id[11]
    both = np.intersect1d(walk.thing[7], walk.thing[11])
    for thing in both[both != NO_TRUTH]:
        assert before[walk.thing[7] == thing] == after[walk.thing[11] == thing]


def test_the_memory_stays_in_32_bits_where_jax_computes_in_64(x64):
    walk = pan()
    block = jax.tree.map(operator.itemgetter(slice(BLOCK)), (walk.sightings, walk.motion))
    scan = functools.partial(scan_block, static=STATIC)
    state = jax.eval_shape(scan, init(STATIC), block, PlusThresholds())[0]
    assert not [leaf.dtype for leaf in jax.tree.leaves(state) if leaf.dtype.itemsize > 4]
