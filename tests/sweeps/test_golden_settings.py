"""64 settings side by side say on golden sequences what 64 single runs say."""

import dataclasses

import numpy as np
import pytest

from benchmarks.step import as_frame
from remind_jax.backbone.registry import get_backbone
from remind_jax.config import load_config
from remind_jax.config.dotted_keys import nest
from remind_jax.decision import Outcome
from remind_jax.session.live import Tracker
from remind_jax.sources import open_source
from remind_jax.sweeps.batches import run_batch
from remind_jax.sweeps.scene_arrays import describe_scene, load_scene
from remind_jax.sweeps.settings import draw
from tests.golden import load

SPACE = {
    "matching.match": (0.7, 0.98),
    "similarity.object_weight": (0.2, 1.0),
    "similarity.background_weight": (0.05, 0.5),
    "similarity.parts_weight": (0.0, 0.4),
    "diagnosis.close": (0.02, 0.12),
    "diagnosis.anchor_score": (0.65, 0.95),
    "appearance.duplicate": (0.7, 0.97),
    "lifecycle.confirm_hits": (1, 5),
    "ambiguous.enabled": (True, False),
    "provisional.enabled": (True, False),
    "veto.enabled": (True, False),
}
SETTINGS = draw(SPACE, 64, seed=3)
BATCH = 16
# Of some settings more tracks come into being than have room at first; growing is tested elsewhere
# and would compile every program three times here.
NUM_OBJECTS = {"small": 64, "stress": 128, "two_rooms": 256}


def masks_numbered(frame):
    """The frame with ids of its masks, which sweeps ask for; they decide nothing."""
    ids = np.arange(len(frame.detections)) + 1
    return dataclasses.replace(
        frame, detections=dataclasses.replace(frame.detections, instance_ids=ids)
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["small", "stress", "two_rooms"])
def test_rows_equal_single_runs(name, capsys):
    frames = [masks_numbered(as_frame(i, g)) for i, g in enumerate(load.load_inputs(name))]
    config = load_config("published")
    scene = load_scene(open_source(frames), config, get_backbone("patch-statistics"))
    sizes = {"num_detections": scene.most_detections, "num_objects": NUM_OBJECTS[name]}
    config = config.updated({"static": sizes})
    assert frames[0].features is not None
    static = dataclasses.replace(config.static, feature_dim=frames[0].features.shape[-1])
    described = describe_scene(scene, static, config)
    batches = [
        run_batch(described, config, SETTINGS[first : first + BATCH], static)[0]
        for first in range(0, len(SETTINGS), BATCH)
    ]
    said, decisions = set(), 0
    for index, setting in enumerate(SETTINGS):
        answers, column = batches[index // BATCH], index % BATCH
        assert answers is not None
        tracker = Tracker(config.updated({"thresholds": nest(setting)}))
        for number, frame in enumerate(frames):
            tracks = tracker.update(frame)
            count = len(tracks)  # detections of ignored classes have no row
            outcome = answers.outcome[number, column, :count]
            np.testing.assert_array_equal(outcome, tracks.outcome, f"{setting}, frame {number}")
            firm = np.isin(outcome, (Outcome.MATCH, Outcome.NEW))
            swept = np.where(firm, answers.object_id[number, column, :count], -1)
            alone = np.where(firm, tracks.object_id, -1)
            np.testing.assert_array_equal(swept, alone, f"{setting}, frame {number}")
            decisions += count
        said.add((answers.outcome[:, column].tobytes(), answers.object_id[:, column].tobytes()))
    with capsys.disabled():
        print(f"\n{name}: {decisions} decisions equal, {len(said)} of {len(SETTINGS)} differ")
    assert len(said) > len(SETTINGS) // 2, "the settings must really differ"
