"""Every baseline against the same method in plain loops, and the contract of `methods.Method`."""

import dataclasses
import functools

import chex
import jax
import numpy as np
import pytest

from remind_jax.compiled.frame_step import settle_types
from remind_jax.config import load_config
from remind_jax.decision import Outcome
from remind_jax.method import get_method
from remind_jax.session import live
from remind_jax.static import Static
from tests import tiny_world as world
from tests.baselines import references
from tests.cli import scenes
from tests.session.test_live import assert_same_answers

REFERENCES = {
    "momentum": references.momentum,
    "running-mean": references.running_mean,
    "bank": references.bank,
    "iou": references.boxes,
}
STATIC = Static(num_detections=world.BOXES, num_objects=64, feature_dim=world.DIM)
NUM_FRAMES = 40  # banks of twelve are full long before


@functools.cache
def stepper(name: str):
    """One step as a program; the memory comes back in the types that it is given in."""
    step = get_method(name).step
    return jax.jit(
        lambda *given, **options: settle_types(step(*given, **options)), static_argnames="static"
    )


def track(name: str, frames, static: Static = STATIC, **changes):
    method = get_method(name)
    thresholds = dataclasses.replace(method.settings(), **changes)
    state = settle_types(method.init(static))
    states = []
    for feats, masks in frames:
        state = stepper(name)(state, feats, masks, static=static, thresholds=thresholds)
        states.append(jax.device_get(state))
    return states


def identities(states, frames) -> list[list[int]]:
    return [
        state.decisions.object_id[masks.valid].tolist()
        for state, (_, masks) in zip(states, frames, strict=True)
    ]


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("name", REFERENCES)
def test_agrees_with_plain_loops(name, seed):
    frames = world.make_frames(NUM_FRAMES, seed=seed)
    strict = {} if name == "iou" else {"match": 0.75 if name == "momentum" else 0.9}
    expected = REFERENCES[name]([references.see(frame) for frame in frames], **strict)
    assert identities(track(name, frames, **strict), frames) == expected
    assert len({i for ids in expected for i in ids}) > world.BOXES  # mistakes are made alike, too


def test_weak_and_overlapping_detections_are_dropped_by_momentum_alone():
    feats, masks = world.make_frames(1, seed=0, share=1.0)[0]
    score = np.array([0.9, 0.4, 0.05, 0.8, 0.3, 0.6], np.float32)
    box = masks.box.copy()
    box[1] = box[0] + 1  # overlaps a stronger one, and is weak
    box[4] = box[0] + 2
    frame = (feats, dataclasses.replace(masks, detector_score=score, box=box))
    state = track("momentum", [frame])[0]
    assert state.decisions.outcome.tolist() == [
        Outcome.NEW,
        Outcome.DROPPED,
        Outcome.UNASSIGNED,
        Outcome.NEW,
        Outcome.DROPPED,
        Outcome.NEW,
    ]
    sights = [references.see(frame)]
    assert identities([state], [frame]) == REFERENCES["momentum"](sights)
    assert set(track("bank", [frame])[0].decisions.outcome.tolist()) == {Outcome.NEW}


@pytest.mark.parametrize("name", REFERENCES)
def test_capacities_change_nothing(name):
    frames = world.make_frames(12, seed=5)
    roomy = identities(track(name, frames), frames)
    wide = dataclasses.replace(STATIC, num_detections=9, num_objects=100)
    padded = world.pad(frames, 9)
    assert identities(track(name, padded, wide), padded) == roomy


@pytest.mark.parametrize("name", REFERENCES)
def test_a_frame_that_does_not_fit_changes_nothing_and_fits_after_growth(name):
    frames = world.make_frames(4, seed=1, share=1.0)
    tight = dataclasses.replace(STATIC, num_objects=4)
    before = settle_types(get_method(name).init(tight))
    after = track(name, frames[:1], tight)[0]
    assert after.overflow.objects == world.BOXES
    kept = dataclasses.replace(after, overflow=before.overflow)
    chex.assert_trees_all_equal(before, kept)

    method = get_method(name)
    state = method.enlarge(kept, STATIC)
    state = stepper(name)(state, *frames[0], static=STATIC, thresholds=method.settings())
    assert state.overflow.objects == 0
    assert state.decisions.object_id.tolist() == list(range(world.BOXES))


def test_features_that_are_not_finite_never_reach_memory():
    feats, masks = world.make_frames(1, seed=2, share=1.0)[0]
    patches = feats.patches.copy()
    patches[masks.coverage[3] > 0] = np.nan
    broken = (dataclasses.replace(feats, patches=patches), masks)
    for name in ("momentum", "running-mean", "bank"):
        state = track(name, [broken])[0]
        assert state.decisions.outcome[3] == Outcome.DROPPED
        assert state.decisions.num_bad_patches == np.isnan(patches[..., 0]).sum()
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.looks))


def test_iou_forgets_at_once_and_uses_slots_again():
    here, elsewhere = world.make_frames(2, seed=0, share=1.0)
    nobody = (here[0], dataclasses.replace(here[1], valid=np.zeros(world.BOXES, bool)))
    tight = dataclasses.replace(STATIC, num_objects=world.BOXES)
    states = track("iou", [here, elsewhere, nobody, nobody, here], tight)
    assert states[1].decisions.object_id.tolist() == list(range(6))  # boxes move by two pixels
    assert states[-1].decisions.object_id.tolist() == list(range(6, 12))
    patient = track("iou", [here, nobody, nobody, here], tight, patience=3)
    assert patient[-1].decisions.object_id.tolist() == list(range(6))


@pytest.mark.parametrize("name", REFERENCES)
def test_runs_live_with_profiles_candidates_and_memory_on_disk(name, tmp_path):
    config = load_config("default").with_tracker(name)
    tracker = live.Tracker(config)
    tracks = scenes.follow(tracker, range(3))[-1]
    assert tracks.is_firm.all()
    assert (tracks.candidate_id[:, 0] == tracks.object_id)[tracks.outcome == Outcome.MATCH].all()
    tracker.save(tmp_path / "memory")
    again = live.Tracker(config)
    again.load(tmp_path / "memory")
    assert_same_answers(*(scenes.follow(one, [0]) for one in (tracker, again)))
