"""Sweeps over REMIND plus: every row is the single run with that setting."""

import dataclasses

import numpy as np
import pytest

import remind_jax as rj
from remind_jax.backbone.registry import get_backbone
from remind_jax.config import load_config
from remind_jax.config.dotted_keys import nest
from remind_jax.errors import ConfigError
from remind_jax.metrics import evaluate_tracks
from remind_jax.sources import open_source
from remind_jax.sweeps import draw, sweep
from remind_jax.sweeps.batches import run_batch
from remind_jax.sweeps.scene_arrays import describe_scene, load_scene
from remind_jax.synthetic import LookalikeGroup, SceneOptions, make_scene, render
from tests.sweeps.tiny_sweep import SCENES

CONFIG = load_config("plus").updated({"static": {"num_detections": 8, "num_objects": 48}})
SPACE = {
    "decision.new": (0.0, 2.5),
    "decision.commit_age": (2, 8),
    "decision.firm": (0.3, 0.7),
    "layout.weight": (0.0, 1.2),
    "place.weight": (0.0, 1.2),
    "looks.gain": (0.4, 1.2),
    "looks.whitening": (True, False),
    "looks.unit_patches": (True, False),
    "linking.least": (-2.0, 1.0),
    "motion.checked": (True, False),
}
SETTINGS = draw(SPACE, 12, seed=2)


def tour(seed):
    """Look-alikes that the camera leaves and returns to, in the dark."""
    options = SceneOptions(
        name=f"tour{seed}", seed=seed, width=160, height=128, min_mask_px=25, frames=40,
        objects_per_room=7, absence_frames=12, light_drop=0.3,
        lookalikes=(LookalikeGroup("mug", 3), LookalikeGroup("box", 2, "tint")),
    )  # fmt: skip
    return list(render(make_scene(options)))


@pytest.fixture(scope="module")
def scenes():
    return [tour(seed) for seed in (1, 2)]


@pytest.fixture(scope="module")
def alone(scenes):
    """Frame by frame what every setting says in a run of its own, `[scenes][settings]`."""
    return [
        [list(follow(frames, CONFIG.updated({"thresholds": nest(s)}))) for s in SETTINGS]
        for frames in scenes
    ]


def follow(frames, config):
    tracker = rj.Tracker(config)
    return (tracker.update(frame) for frame in frames)


@pytest.mark.slow
def test_answers_equal_single_runs(scenes, alone):
    said = set()
    for frames, runs in zip(scenes, alone, strict=True):
        scene = load_scene(open_source(frames), CONFIG, get_backbone("patch-statistics"))
        width = scene.feats[0].patches.shape[-1]
        static = dataclasses.replace(CONFIG.static, feature_dim=width)
        for unit in (True, False):
            chosen = [i for i, s in enumerate(SETTINGS) if s["looks.unit_patches"] == unit]
            config = CONFIG.updated({"thresholds": {"looks": {"unit_patches": unit}}})
            described = describe_scene(scene, static, config)
            filled = [SETTINGS[i] for i in chosen + chosen[:1] * (len(SETTINGS) - len(chosen))]
            answers, _ = run_batch(described, CONFIG, filled, static)
            assert answers is not None
            for column, index in enumerate(chosen):
                for number, tracks in enumerate(runs[index]):
                    count = len(tracks)
                    outcome = answers.outcome[number, column, :count]
                    ids = answers.object_id[number, column, :count]
                    note = f"{SETTINGS[index]}, frame {number}"
                    np.testing.assert_array_equal(outcome, tracks.outcome, note)
                    np.testing.assert_array_equal(ids, tracks.object_id, note)
                said.add((scene.name, answers.object_id[:, column].tobytes()))
    assert len(said) > len(SETTINGS), "the settings must really differ"


@pytest.mark.slow
def test_rows_are_the_scores_of_single_runs_whatever_the_capacities(scenes, alone):
    small = CONFIG.updated({"static": {"num_objects": 12}})  # fewer than a frame may need
    result = sweep(scenes, SETTINGS, config=small, batch=12, delay=0)
    for rows, *runs in zip(result.rows, *alone, strict=True):
        for row, tracks in zip(rows, runs, strict=True):
            scores = evaluate_tracks(tracks).scores()
            for name in ("IDF1", "HOTA", "AssA", "Recovery", "HardRecovery"):
                # Single precision on the device.
                assert row.scores[name] == pytest.approx(scores[name], abs=1e-5, nan_ok=True), name
    assert len({row.scores["IDF1"] for rows in result.rows for row in rows}) > len(SETTINGS)


@pytest.mark.slow
def test_rows_are_the_scores_of_runs_that_wait(scenes):
    settings = [{}, {"decision.new": 2.5}, {"decision.commit_age": 8}]
    at_once = sweep(scenes[:1], settings, config=CONFIG, delay=0)
    result = sweep(scenes[:1], settings, config=CONFIG)
    for setting, (row,) in zip(settings, result.rows, strict=True):
        config = CONFIG.updated({"thresholds": nest(setting)})
        scores = evaluate_tracks(rj.run(scenes[0], config=config, progress=False).tracks).scores()
        for name in ("IDF1", "HOTA", "AssA", "Recovery", "HardRecovery"):
            # Single precision on the device.
            assert row.scores[name] == pytest.approx(scores[name], abs=1e-5, nan_ok=True), name
    assert not np.array_equal(at_once.table(), result.table(), equal_nan=True)


def test_thresholds_are_those_of_the_method():
    with pytest.raises(ConfigError, match=r"'matching\.match' .* of tracker 'remind'"):
        sweep(SCENES, {"matching.match": [0.5]}, config="plus")
