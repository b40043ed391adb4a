"""A frame with more detections than are taken is skipped and told, whatever form they come in."""

import json

import numpy as np
import pytest

import remind_jax as rj
from remind_jax import crops
from remind_jax.errors import SourceError
from remind_jax.session import machine_memory
from remind_jax.static import MOST_DETECTIONS
from tests.sources import making

HEIGHT, WIDTH = 90, 100
TOO_MANY = MOST_DETECTIONS + 1
SAID = f"{TOO_MANY} detections, at most {MOST_DETECTIONS}"


@pytest.fixture
def images(tmp_path):
    making.write_images(tmp_path / "images", ["0.png", "1.png"], (HEIGHT, WIDTH))
    return tmp_path / "images"


def crowd():
    """An instance map of more than there may be."""
    labels = np.zeros(HEIGHT * WIDTH, np.uint16)
    labels[:TOO_MANY] = np.arange(1, TOO_MANY + 1)
    return labels.reshape(HEIGHT, WIDTH)


def write_maps(folder):
    few = np.zeros((HEIGHT, WIDTH), np.uint16)
    few[10:50, 20:60] = 3
    for index, labels in enumerate((crowd(), few)):
        making.write_image(folder / "masks" / f"{index}.png", labels)
    return folder / "masks"


def as_frames(folder):
    one = {"bbox": [1, 1, 30, 30], "label": "cup"}
    frames = [{"frame": i, "detections": [one] * num} for i, num in enumerate((TOO_MANY, 1))]
    (folder / "masks.json").write_text(json.dumps(frames))
    return folder / "masks.json"


@pytest.mark.parametrize("write", [write_maps, as_frames])
def test_the_frame_is_skipped_counted_and_told(write, images, tmp_path):
    source = rj.open_source(images, masks=write(tmp_path))
    (frame,) = source
    assert frame.source_index == 1
    assert len(frame.detections) == 1
    (skipped,) = source.skipped
    assert skipped.name == "0.png"
    assert SAID in skipped.reason


ONE = np.ones((2, 3), bool)


@pytest.mark.parametrize(
    "given",
    [
        np.ones((TOO_MANY, 2, 3), bool),
        crowd(),
        {"boxes": np.ones((TOO_MANY, 4))},
        {"masks": np.ones((TOO_MANY, 2, 3), bool)},
        [{"segmentation": ONE, "predicted_iou": 0.5}] * TOO_MANY,
    ],
)
def test_a_live_frame_is_refused_in_a_sentence(given):
    size = given.shape[-2:] if isinstance(given, np.ndarray) else ONE.shape
    tracker = rj.Tracker()
    with pytest.raises(SourceError, match=SAID):
        tracker.update(np.zeros((*size, 3), np.uint8), given)


def test_boxes_of_large_pictures_are_compared_before_they_are_filled(monkeypatch):
    monkeypatch.setattr(crops, "MAX_MASK_BYTES", 10_000)
    boxes = np.array([[0, 0, 100, 90.0]] * 2)
    with pytest.raises(SourceError, match="2 detections in 100x90 pixels"):
        rj.sources.detections_from({"boxes": boxes}, (HEIGHT, WIDTH))


def test_a_tracker_takes_no_more_than_it_has_memory_for(monkeypatch):
    monkeypatch.setattr(machine_memory, "MAX_FRAME_BYTES", 1)
    most = rj.load_config("default").static.num_detections
    assert rj.Tracker().most_detections == most
    chosen = {"static": {"num_detections": 4 * most}}
    assert rj.Tracker({"base": "default", **chosen}).most_detections == 4 * most

    image = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    maps = np.zeros((2, HEIGHT, WIDTH), np.uint8)
    maps[0, :, : most + 1] = np.arange(1, most + 2)
    maps[1, 10:60, 20:60] = 1
    result = rj.run(np.stack([image] * 2), masks=maps, progress=False)
    assert [len(tracks) for tracks in result.tracks] == [1]
    (skipped,) = result.skipped
    assert f"{most + 1} detections, at most {most}" in skipped.reason
    assert f"static.num_detections={most + 1}" in skipped.reason


def test_a_method_that_does_not_count_its_bytes_has_a_bound_as_well():
    assert rj.Tracker(tracker="iou").most_detections == machine_memory.MAX_UNCOUNTED


def test_no_frame_asks_for_more_than_is_meant_for_it():
    tracker = rj.Tracker()
    most = tracker.most_detections
    assert 500 <= most < MOST_DETECTIONS
    room = rj.Static(num_detections=most, num_objects=2 * most, feature_dim=tracker.backbone.dim)
    assert tracker.method.host.count_bytes(room) <= machine_memory.MAX_FRAME_BYTES
