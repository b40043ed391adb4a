"""Folders that pictures, and their masks, are added to while they are read."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import remind_jax as rj
from remind_jax.errors import SourceError
from remind_jax.sources import LiveSource
from tests.cli.scenes import CLASSES
from tests.sources.cameras import ids_at, number_in, shown_at


class Robot:
    """Writes pictures and instance maps into two folders."""

    def __init__(self, folder: Path) -> None:
        self.images, self.masks = folder / "images", folder / "masks"
        self.images.mkdir()
        self.masks.mkdir()
        names = {str(instance): name for instance, name in CLASSES.items()}
        (self.masks / "metadata.json").write_text(json.dumps({"id_to_class": names}))

    def write_image(self, number: int) -> bytes:
        image = cv2.cvtColor(shown_at(number)[0], cv2.COLOR_RGB2BGR)
        data = cv2.imencode(".png", image)[1].tobytes()
        self.put(self.images / f"{number:04d}.png", data)
        return data

    def write_mask(self, number: int) -> None:
        data = cv2.imencode(".png", shown_at(number)[1])[1].tobytes()
        self.put(self.masks / f"{number:04d}.png", data)

    def write(self, *numbers: int) -> None:
        for number in numbers:
            self.write_image(number)
            self.write_mask(number)

    def put(self, path: Path, data: bytes) -> None:
        part = path.with_name(f".{path.name}.part")
        part.write_bytes(data)
        part.rename(path)


@pytest.fixture
def robot(tmp_path) -> Robot:
    return Robot(tmp_path)


def follow(robot: Robot, with_masks: bool = True, **options) -> LiveSource:
    masks = robot.masks if with_masks else "none"
    source = rj.open_source(robot.images, masks=masks, follow=True, **options)
    assert isinstance(source, LiveSource)
    return source


def soon(act: Callable[[], object], after_s: float = 0.1) -> threading.Timer:
    timer = threading.Timer(after_s, act)
    timer.start()
    return timer


def test_the_newest_picture_is_taken_with_its_mask(robot):
    robot.write(*range(5))
    source = follow(robot)
    frames: Any = iter(source)
    first = next(frames)
    assert (first.name, first.source_index) == ("0004.png", 4)
    robot.write(5, 6, 7, 8)
    time.sleep(0.5)
    second = next(frames)
    num_between = 0
    while second.name != "0008.png":  # a busy machine has not seen all of them yet
        num_between, second = num_between + 1, next(frames)
    assert second.source_index == 8
    assert second.detections is not None
    assert second.detections.labels == tuple(CLASSES[i] for i in ids_at(8))
    assert (second.detections.masks == (shown_at(8)[1] == np.array([1, 2, 3])[:, None, None])).all()
    frames.close()
    assert num_between < 3
    assert source.skipped[0].count == 3 - num_between


def test_every_picture_is_taken_in_order_where_that_is_wanted(robot):
    robot.write(0, 1, 2)
    source = follow(robot, every_frame=True, sampling={"max_frames": 12})
    for number in range(3, 12):
        soon(lambda n=number: robot.write(n), 0.05 * number)
    names = []
    for frame in source:
        names.append(frame.name)
        time.sleep(0.1)
    assert names == [f"{number:04d}.png" for number in range(12)]
    assert source.skipped == []


def test_a_picture_waits_for_its_mask(robot):
    robot.write(0)
    source = follow(robot)
    frames: Any = iter(source)
    next(frames)
    robot.write_image(1)
    written = []

    def write_mask() -> None:
        written.append(1)
        robot.write_mask(1)

    soon(write_mask, 0.3)
    assert next(frames).name == "0001.png"
    assert written
    frames.close()


def test_a_picture_that_is_being_written_is_waited_for(robot):
    robot.write(0)
    source = follow(robot, with_masks=False)
    frames: Any = iter(source)
    next(frames)
    whole = robot.write_image(1)
    path = robot.images / "0002.png"
    path.write_bytes(whole[: len(whole) // 2])
    assert next(frames).name == "0001.png"
    soon(lambda: path.write_bytes(whole), 0.3)
    frame = next(frames)
    assert frame.name == "0002.png"
    assert number_in(frame.image) == 1
    frames.close()
    assert source.skipped == []


def test_a_folder_that_is_empty_yet(robot):
    source = follow(robot)
    soon(lambda: robot.write(0), 0.3)
    frames: Any = iter(source)
    assert next(frames).name == "0000.png"
    frames.close()


def test_a_folder_that_nothing_is_added_to_ends_well(robot):
    robot.write(0, 1)
    assert [frame.name for frame in follow(robot, reconnect=0.3)] == ["0001.png"]


def test_a_folder_that_stays_empty_is_an_error(robot):
    with pytest.raises(SourceError, match=r"got no picture with a mask within 0\.3 s; is it the r"):
        list(follow(robot, reconnect=0.3))


def test_no_longer_than_the_duration_is_waited(robot):
    with pytest.raises(SourceError, match=r"got no picture with a mask within 0\.2 s"):
        list(follow(robot, duration=0.2, reconnect=600.0))


def test_classes_that_come_later_are_found(robot):
    (robot.masks / "metadata.json").write_text('{"id_to_class": {"1": "cup", "2": "cup"}}')
    robot.write(0)
    with pytest.raises(SourceError, match=r"instances 3 in .* have no class; add them to"):
        next(iter(follow(robot)))
    names = {str(instance): name for instance, name in CLASSES.items()}
    source = follow(robot)
    (robot.masks / "metadata.json").write_text(json.dumps({"id_to_class": names}))
    frame = next(iter(source))
    assert frame.detections is not None
    assert frame.detections.labels == ("cup", "cup", "book")


def test_a_davis_folder_grows_with_its_annotations(tmp_path):
    images, maps = tmp_path / "JPEGImages" / "room", tmp_path / "Annotations" / "room"
    images.mkdir(parents=True)
    maps.mkdir(parents=True)
    image, labels = shown_at(0)
    cv2.imwrite(str(images / "00000.jpg"), image)
    cv2.imwrite(str(maps / "00000.png"), labels)
    frames = iter(rj.open_source(images, follow=True))
    assert len(next(frames).detections or ()) == 3


def test_duration_ends_a_folder(robot):
    robot.write(0)
    began = time.monotonic()
    assert len(list(follow(robot, duration=0.4))) == 1
    assert time.monotonic() - began < 10


@pytest.mark.parametrize(
    ("spec", "masks", "told"),
    [
        ("images/0000.png", None, "is no folder; give the one that pictures are added to"),
        ("nowhere", None, "is no folder; give the one that pictures are added to"),
        ("images", "masks.json", "must be a folder of instance maps"),
        ("images", np.zeros((1, 4, 4)), "cannot come along with a folder that grows"),
        (np.zeros((1, 4, 4, 3), np.uint8), None, "a ndarray is no folder that grows"),
    ],
)
def test_what_cannot_grow(robot, tmp_path, monkeypatch, spec, masks, told):
    monkeypatch.chdir(tmp_path)
    robot.write(0)
    with pytest.raises(SourceError) as caught:
        rj.open_source(spec, masks=masks, follow=True)
    assert told in str(caught.value)
