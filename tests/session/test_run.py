"""`run`: one call from frames to identities, in whatever form, and what an interruption leaves.

All runs share the compiled program of the tests of the live tracker.
"""

import importlib.metadata
import itertools
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

import remind_jax as rj
from remind_jax.backbone.registry import get_backbone
from remind_jax.baselines.bank import BankThresholds
from remind_jax.decision import Outcome
from remind_jax.errors import ConfigError, OutputError, SourceError
from remind_jax.frame import Detections, Frame
from remind_jax.outputs.result import Result
from remind_jax.outputs.writer import MEMORY_NAME, RunWriter
from remind_jax.session.live import Tracker
from remind_jax.session.progress import Progress
from remind_jax.sources import detections_from, open_source
from tests.cli import scenes
from tests.session.test_live import assert_same_answers
from tests.sources import making

NUM = 6
PICTURES = [scenes.picture(index) for index in range(NUM)]


def identities(result: Result) -> list[list[int]]:
    return [tracks.object_id.tolist() for tracks in result.tracks]


@pytest.fixture(scope="module")
def whole() -> Result:
    """The run that all others are compared with: pairs of image and instance map."""
    return rj.run(PICTURES)


def test_features_that_are_not_finite_are_left_out_and_reported():
    images, maps = zip(*PICTURES[:3], strict=True)
    features = np.array(get_backbone().extract(np.stack(images)))
    features[1, 0, 0, 0], features[1, 1, 1, 1] = np.nan, np.inf
    frames = [
        Frame(i, i, 0.1 * i, str(i), None, detections_from(found, found.shape), features[i])
        for i, found in enumerate(maps)
    ]
    result = rj.run(frames)
    assert len(result) == 3
    (event,) = result.events
    assert (event.frame_index, event.kind) == (1, "features")
    assert event.message.startswith("2 patches were left out")
    assert event.message in repr(result)


def test_three_objects_keep_their_identity(whole):
    assert identities(whole) == [[0, 1, 2]] * NUM
    assert whole.complete
    assert [tracks.frame_index for tracks in whole.tracks] == list(range(NUM))
    first, *others = (tracks.outcome for tracks in whole.tracks)
    assert (first == Outcome.NEW).all()
    assert (np.array(others) == Outcome.MATCH).all()
    assert {len(times) for times in whole.timings_ms.values()} == {NUM}


def test_versions_are_those_of_the_modules_however_they_were_installed(monkeypatch):
    def lacks(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", lacks)
    versions = rj.run(PICTURES[:1], tracker="bank").info.versions
    assert versions["opencv"] == cv2.__version__
    assert versions["remind_jax"] == rj.__version__


def test_seconds_of_compiling_are_those_of_the_tracker(monkeypatch, tmp_path):
    class Waiting(Tracker):
        compile_s = property(lambda self: 1.5, lambda self, value: None)

    monkeypatch.setattr("remind_jax.session.run.Tracker", Waiting)
    result = rj.run(PICTURES[:1], tracker="bank", out=tmp_path)
    assert result.compile_s == result.summary()["compile_s"] == 1.5
    assert Result.load(tmp_path).compile_s == 1.5


def test_thresholds_reported_are_those_that_decided():
    live = Tracker(tracker="bank")
    live.update(*PICTURES[0])
    config = rj.run(PICTURES[:1], tracker="bank").info.config
    # What was left to the run is reported as it ran: masks are announced at once.
    assert config == live.config.updated({"input": {"announce_after": 1}}).to_dict()
    assert config["thresholds"]["match"] != BankThresholds().match


def as_arrays() -> dict[str, Any]:
    images, maps = zip(*PICTURES, strict=True)
    return {
        "source": np.stack(images),
        "masks": np.stack(maps),
        "class_names": dict.fromkeys(range(1, 4), "object 1"),
    }


def as_iterator() -> dict[str, Any]:
    return {"source": iter([(image, scenes.masks_of(labels)) for image, labels in PICTURES])}


def as_frames() -> dict[str, Any]:
    frames = [
        Frame(
            index, index, index / 30, str(index), image, Detections.create(scenes.masks_of(labels))
        )
        for index, (image, labels) in enumerate(PICTURES)
    ]
    return {"source": frames}


def as_detector() -> dict[str, Any]:
    known = {image.tobytes(): scenes.masks_of(labels) for image, labels in PICTURES}
    images = [image for image, _ in PICTURES]
    return {"source": images, "detector": lambda image: {"masks": known[image.tobytes()]}}


@pytest.mark.parametrize("give", [as_arrays, as_iterator, as_frames, as_detector])
def test_the_form_of_the_input_does_not_matter(whole, give):
    assert_same_answers(rj.run(**give()).tracks, whole.tracks)


def test_a_run_folder_says_what_found_the_detections(tmp_path):
    result = rj.run(**as_detector(), tracker="iou", out=tmp_path, overlay=False)
    detector = Result.load(tmp_path).info.detector
    assert detector == json.loads(json.dumps(result.info.detector))
    assert detector is not None
    assert detector["kind"] == "callable"
    assert detector["options"]["erosion_px"] == 0


def test_going_on_from_a_memory_file_is_going_on(whole, tmp_path):
    first = rj.run(PICTURES[:3], out=tmp_path / "first", overlay=False)
    memory = tmp_path / "first" / MEMORY_NAME
    with pytest.raises(OutputError, match="first"):  # would be gone if the run is killed
        rj.run(PICTURES[3:], memory=memory, out=tmp_path / "first", overwrite=True)
    rest = rj.run(PICTURES[3:], memory=memory)
    assert rest.info.config["static"] == {**first.info.config["static"], "feature_dim": 223}
    assert_same_answers((*first.tracks, *rest.tracks), whole.tracks)


def test_progress_counts(whole):
    seen: list[Progress] = []
    rj.run(PICTURES, progress=seen.append)
    assert [step.num_done for step in seen] == [*range(1, NUM + 1)]
    assert {step.num_frames for step in seen} == {NUM}
    assert seen[-1].num_identities == 3
    assert seen[-1].undecided_share == 0


def test_a_source_that_fails_midway_leaves_finished_outputs(whole, tmp_path):
    def failing() -> Iterator[Any]:
        yield from itertools.islice(PICTURES, 2)
        raise SourceError("the camera is gone")

    out = tmp_path / "run"
    with pytest.raises(SourceError, match="the camera is gone"):
        rj.run(failing(), out=out, overlay=False)
    kept = Result.load(out)
    assert not kept.complete
    assert identities(kept) == identities(whole)[:2]
    assert (out / MEMORY_NAME).is_file()


def test_an_occupied_folder_is_refused_before_anything_is_done(tmp_path):
    """Neither is the source opened, nor anything compiled or written."""
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match="not empty"):
        rj.run("no such video.mp4", detector="no such model.onnx", out=tmp_path)
    with pytest.raises(OutputError, match="is a file"):
        rj.run("no such video.mp4", out=tmp_path / "thesis.tex")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.slow
def test_more_detections_and_objects_than_fit_change_nothing(whole):
    small = {"static": {"num_detections": 2, "num_objects": 2, "num_pending": 4}}
    grown = rj.run(PICTURES, config=small)
    assert grown.events == ()
    assert grown.grown_at
    assert identities(grown) == identities(whole)


def test_a_detector_may_describe_itself_in_numbers_of_numpy(tmp_path):
    class Whole:
        def __init__(self):
            self.dropped = Counter()

        def __call__(self, image):
            return Detections.create(np.ones((1, *image.shape[:2]), bool))

        def describe(self):
            return {"confidence": np.float32(0.5), "sizes": np.arange(2), "file": Path("a.onnx")}

    rj.run(PICTURES[:1], detector=Whole(), out=tmp_path, overlay=False)
    said = {"confidence": 0.5, "sizes": [0, 1], "file": "a.onnx"}
    assert Result.load(tmp_path).info.detector == said


def test_viewers_get_every_frame(tmp_path):
    from mcap.reader import make_reader

    mcap = tmp_path / "out.mcap"
    rj.run(PICTURES[:3], out=tmp_path / "run", overlay=False, mcap=mcap)
    for given, said in ((mcap, r"out\.mcap' exists"), (tmp_path / "no" / "x.mcap", "no folder")):
        with pytest.raises(OutputError, match=said):
            rj.run(PICTURES[:3], out=tmp_path / "other", mcap=given)
    with mcap.open("rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    assert topics.count("/remind/tracks") == 3
    with pytest.raises(ConfigError, match="'mcap' records a run that is written to a folder"):
        rj.run(PICTURES, mcap=mcap)


def test_a_memory_that_cannot_be_written_leaves_the_rest(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OutputError("the disk is full")

    monkeypatch.setattr(rj.Tracker, "save", refuse)
    with pytest.raises(OutputError, match="the disk is full"):
        rj.run(PICTURES[:3], out=tmp_path / "run", overlay=False)
    assert (tmp_path / "run" / "report.html").is_file()
    assert len(Result.load(tmp_path / "run").tracks) == 3


def test_what_cannot_be_written_any_more_leaves_a_run_that_says_so(tmp_path, monkeypatch):
    add, added = RunWriter.add, []

    def add_two(writer, frame, tracks):
        if len(added) == 2:
            raise OutputError("the disk is full")
        added.append(frame)
        add(writer, frame, tracks)

    monkeypatch.setattr(RunWriter, "add", add_two)
    with pytest.raises(OutputError, match="the disk is full"):
        rj.run(PICTURES[:4], out=tmp_path, overlay=False, delay=2)
    assert json.loads((tmp_path / "run.json").read_text())["complete"] is False


def write_frames(folder: Path, masks: list[str]) -> None:
    """Two frames, and for these empty masks."""
    making.write_images(folder / "frames", ["0.png", "1.png"])
    (folder / "masks").mkdir()
    for name in masks:
        making.write_image(folder / "masks" / name, np.zeros(making.SIZE, np.uint8))


def test_what_the_source_has_to_say_is_in_the_result(tmp_path):
    write_frames(tmp_path, masks=["0.png"])
    result = rj.run(tmp_path / "frames", masks=tmp_path / "masks")
    (event,) = result.events
    assert (event.frame_index, event.kind) == (-1, "input")
    assert "1 of 2" in event.message


def test_masks_of_no_frame_are_told(tmp_path):
    write_frames(tmp_path, masks=["0.png", "1.png", "2.png", "3.png"])
    (event,) = rj.run(tmp_path / "frames", masks=tmp_path / "masks").events
    assert "2 annotations in" in event.message
    assert "(first '2.png') belong to no frame of 'frames'" in event.message


def test_masks_and_a_detector_exclude_each_other(tmp_path):
    write_frames(tmp_path, masks=["0.png", "1.png"])
    folders = tmp_path / "frames", tmp_path / "masks"
    for source, more in (
        (folders[0], {"masks": folders[1]}),
        (open_source(folders[0], masks=folders[1]), {}),
    ):
        with pytest.raises(ConfigError, match="masks and a detector exclude each other"):
            rj.run(source, detector=lambda image: None, **more)
    assert rj.run(folders[0], masks="none", detector=lambda image: None).complete
    with pytest.raises(ConfigError, match=r"'class_names' .* detector_options="):
        rj.run(folders[0], masks="none", detector=lambda image: None, class_names=["cup"])


def test_a_slow_recording_keeps_its_rate_beside_an_overlay_that_plays(tmp_path):
    write_frames(tmp_path, masks=["0.png", "1.png"])
    given = {"masks": tmp_path / "masks", "image_fps": 0.001}
    result = rj.run(tmp_path / "frames", out=tmp_path / "run", **given)
    assert result.info.fps == Result.load(tmp_path / "run").info.fps == 0.001
    with av.open(str(tmp_path / "run" / "overlay.mp4")) as video:
        assert video.streams.video[0].average_rate == 10
