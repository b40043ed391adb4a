"""What looks, background, place and rivals say about an open tracklet and each object."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.plus import evidence
from remind_jax.plus.class_names import confusion_odds, name_odds
from remind_jax.plus.evidence import best_cosine, mix, shortlist
from tests.plus.frames import T, detections, empty_state, objects_of, tracklets_of

LOOKS = [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]
NOBODY = jnp.zeros(4, bool)
calibrate = jax.jit(evidence.calibrate)


def candidates(objects, seen, held=NOBODY, waiting=NOBODY, here=None, cosine=None, scene=None):
    here = tracklets_of(seen, 0, 3) if here is None else here
    cosine = best_cosine(seen.look, objects) if cosine is None else cosine
    scene = empty_state().scene if scene is None else scene
    return _candidates(here, objects, seen, held, waiting, cosine, scene)


@jax.jit
def _candidates(here, objects, seen, held, waiting, cosine, scene):
    state = empty_state()
    admitted = jnp.broadcast_to(objects.exists & ~held, (3, 4))
    names = name_odds(here.class_id, objects.class_id, confusion_odds(scene, T.names))
    return shortlist(here, seen, admitted, waiting, cosine, names, objects, state.pairs, scene, T)


def test_the_object_that_looks_and_lies_alike_comes_first():
    places = jnp.array([[1.0, 1], [3, 1], [5, 1], [0, 0]])
    objects = objects_of(LOOKS, position=places)
    seen = detections(places[:3], LOOKS)
    found = candidates(objects, seen)
    assert found.slot[:, 0].tolist() == [0, 1, 2]
    looks, place = found.evidence.looks[0], found.evidence.place[0]
    assert looks[0] > 0
    assert place[0] > place[1]
    np.testing.assert_allclose(found.evidence.total()[0, :3], found.base[0, :3], rtol=1e-5)


def test_what_is_held_by_another_tracklet_is_no_candidate():
    objects = objects_of(LOOKS)
    found = candidates(objects, detections([[1, 1]] * 3, LOOKS), held=NOBODY.at[0].set(True))
    assert not (np.asarray(found.valid) & (np.asarray(found.slot) == 0)).any()


def test_one_whose_tracklet_may_resume_costs_something():
    objects = objects_of(LOOKS)
    seen = detections([[1, 1]] * 3, LOOKS)
    free = candidates(objects, seen)
    waits = candidates(objects, seen, waiting=NOBODY.at[0].set(True))
    np.testing.assert_allclose(free.base[0, 0] - waits.base[0, 0], T.decision.held, rtol=1e-5)


def test_what_no_other_object_looks_like_is_clear_and_what_this_one_never_does():
    """Beyond the usual limits to both sides, by the tails of what was learned."""
    state = empty_state()
    learned = np.array([[300.0, 300.0], [0.0, 285.0], [0.6, 272.0]])  # cosines of 0.0, and of 0.95
    names = ("cosine_weight", "cosine_sum", "cosine_squares")
    scene = dataclasses.replace(state.scene, **dict(zip(names, learned, strict=True)))
    scene = jax.tree.map(jnp.float32, dataclasses.replace(scene, faded=jnp.zeros(2)))
    cosine = jnp.broadcast_to(jnp.array([0.95, 0.0, -0.9, 0.5]), (3, 4))
    seen = detections([[1, 1]] * 3)
    looks = {}
    for title, one in (("learned", scene), ("assumed", state.scene)):
        found = candidates(objects_of(LOOKS), seen, cosine=cosine, scene=one)
        slots = np.asarray(found.slot[0]).tolist()
        looks[title] = [float(found.evidence.looks[0, slots.index(k)]) for k in range(3)]
    alike, other, opposite = looks["learned"]
    assert alike > T.looks.best + 2
    assert other < T.looks.worst - 2
    assert opposite == other, "what is even less alike than others are tells no more"
    assert looks["assumed"][1:] > [T.looks.worst - 0.01] * 2


def lead_of(looks: list[float], waited: bool = True, class_id: int = 0) -> np.ndarray:
    """Evidence of a lead of each object, whose cosines to the detection are given."""
    objects = objects_of(LOOKS, class_id=jnp.array([0, 0, class_id, 0]))
    seen = detections([[1, 1]] * 3)
    here = tracklets_of(seen, 0, 3, duration=np.full(3, 8.0 if waited else 7.0))
    cosine = jnp.broadcast_to(jnp.array([*looks, -1.0]), (3, 4))
    found = candidates(objects, seen, here=here, cosine=cosine)
    lead = np.zeros(4)
    lead[np.asarray(found.slot[0])] = np.asarray(found.evidence.lead[0])
    return lead[:3]


def test_what_looks_far_more_like_one_than_like_the_others_of_its_class_leads():
    lead = lead_of([0.5, -0.5, -0.5])
    assert lead[0] > 0.5
    assert not lead[1:].any()
    assert not lead_of([0.5, 0.4, -0.5]).any(), "the next one is as much like it"
    assert not lead_of([0.0, -0.5, -0.5]).any(), "it looks like none of them"


def test_a_lead_counts_over_some_of_the_class_and_once_views_suffice():
    assert not lead_of([0.5, -0.5, -0.5], waited=False).any()
    assert not lead_of([0.5, -0.5, -0.5], class_id=1).any(), "one of its class is no crowd"


def test_what_ends_undecided_as_new_is_remembered():
    wait = T.decision.commit_age - 1.0
    for age, leans_new, unseen, elapsed, ends in (
        (2, True, wait, 1.0, True),  # before what began then is decided
        (1, True, wait, 1.0, False),  # too brief
        (2, False, wait, 1.0, False),  # taken for a known object
        (2, True, wait - 1.0, 1.0, False),  # may resume
        (2, True, wait, 0.3, True),
        (2, True, 3.0, 20.0, True),  # few frames suffice of a slow camera
        (2, True, 2.0, 20.0, False),
        (2, True, 0.0, 20.0, False),  # in view
    ):
        fields = {"age": age, "leans_new": leans_new, "unseen": unseen}
        fields = {name: np.full(3, value) for name, value in fields.items()}
        tracklets = tracklets_of(detections([[1, 1]] * 3), 0, 3, **fields)
        found = evidence.find_ended(tracklets, jnp.float32(elapsed), T.decision)
        assert bool(found.all()) == ends, (age, leans_new, unseen, elapsed)


def test_calibration_starts_with_what_is_assumed_and_follows_what_is_seen():
    scene = empty_state().scene
    means = T.calibration.other_mean, T.calibration.same_mean
    start = means, [evidence.COSINE_VARIANCE] * 2
    np.testing.assert_allclose(calibrate(scene, T.calibration), start, rtol=1e-4)
    much = dataclasses.replace(
        scene,
        cosine_weight=jnp.array([1e4, 1e4]),
        cosine_sum=1e4 * jnp.array([0.5, 0.9]),
        cosine_squares=1e4 * jnp.array([0.26, 0.82]),
    )
    known = [[0.5, 0.9], [0.01, 0.01]]
    np.testing.assert_allclose(calibrate(much, T.calibration), known, atol=2e-3)
    seen = 1e4 * jnp.array([[1.0, 1.0], [-0.2, 0.4], [0.06, 0.18]])
    one = dataclasses.replace(much, class_cosines=much.class_cosines.at[..., 5].set(seen))
    of_class = jax.jit(evidence.calibrate_class)(one, jnp.array([5, 4]), T.calibration)
    np.testing.assert_allclose(np.array(of_class)[..., 0], [[-0.2, 0.4], [0.02, 0.02]], atol=2e-3)
    np.testing.assert_allclose(np.array(of_class)[..., 1], known, atol=2e-3)
    off = dataclasses.replace(T.calibration, enabled=jnp.array(False))
    of_class = jax.jit(evidence.calibrate_class)(one, jnp.array([5]), off)
    np.testing.assert_allclose(np.array(of_class)[..., 0], start, rtol=1e-6)


def test_a_displacement_never_says_more_against_than_being_elsewhere():
    at = mix(jnp.array([0.0, 1.0, 1e6]), 0.1, 2.0, 0.02, -0.25)
    assert at[0] > at[1] > at[2]
    assert at[2] > np.log(0.02) - 0.25 - 0.1
