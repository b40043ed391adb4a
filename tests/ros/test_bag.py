from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from remind_jax.errors import OutputError, SourceError
from remind_jax.session.live import Tracker
from remind_ros.bag import PUBLISHED, BagTopics, identify_bag, main
from remind_ros.identification import Identification
from tests.ros import messages

TOPICS = BagTopics("/camera/image", instances="/detector/instances")
STEP_NS = 100_000_000
DETECTOR_NS = 40_000_000  # what comes of an image is recorded later than the image


def write_bag(path, stamped):
    """Pictures and their maps, each pair of a stamp."""
    kind = "sensor_msgs/msg/Image"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        to_picture, to_map = (
            writer.add_connection(topic, kind, typestore=messages.TYPES) for topic in TOPICS.names
        )
        for stamp, (picture, numbers) in stamped:
            for outlet, time, said in (
                (to_picture, stamp, messages.image(picture, "rgb8", stamp)),
                (to_map, stamp + DETECTOR_NS, messages.image(numbers, "16UC1", stamp)),
            ):
                writer.write(outlet, time, messages.TYPES.serialize_cdr(said, kind))
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Twelve images with their maps; the fourth map is of another size."""
    shown = [messages.scene(index) for index in range(12)]
    shown[3] = shown[3][0], shown[3][1][:50]
    stamped = ((5_000_000_000 + index * STEP_NS, pair) for index, pair in enumerate(shown))
    return write_bag(tmp_path_factory.mktemp("bags") / "recorded", stamped)


def read_ids(path):
    answers: list[Any]
    with AnyReader([path], default_typestore=messages.TYPES) as reader:
        answers = [
            (time, reader.deserialize(raw, connection.msgtype))
            for connection, time, raw in reader.messages()
            if connection.topic == "/remind/detections"
        ]
        topics = set(reader.topics)
    return topics, [(time, [one.id for one in said.detections]) for time, said in answers]


def test_every_id_in_the_bag_is_that_of_the_run(bag, tmp_path):
    done = identify_bag(bag, tmp_path / "out", TOPICS)
    topics, answers = read_ids(tmp_path / "out")
    assert topics == set(PUBLISHED)
    tracker, expected = Tracker(), []
    for index in (0, 1, 2, *range(4, 12)):
        picture, numbers = messages.scene(index)
        tracks = tracker.update(picture, numbers.astype(int))
        ids = ["" if i < 0 else str(i) for i in tracks.object_id]
        expected.append((5_000_000_000 + index * STEP_NS, ids))
    assert answers == expected
    assert (done.num_images, done.num_detections, done.num_objects) == (11, 22, 2)
    (why,) = done.refused
    assert "5300000000 ns: the instance map has 256x50 pixels" in why


def test_the_command_says_what_it_did(bag, tmp_path, capsys):
    given = [str(bag), str(tmp_path / "out"), "--image", "/camera/image"]
    kept = ["--save", str(tmp_path / "memory")]
    assert main([*given, "--instances", "/detector/instances", *kept]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("22 detections in 11 images; 2 objects in memory")
    assert err.startswith("left out: image at 5300000000 ns")
    given[1] = str(tmp_path / "again")
    load = ["--load", str(tmp_path / "memory")]
    assert main([*given, "--instances", "/detector/instances", *load]) == 0
    assert read_ids(tmp_path / "again")[1][0][1] == read_ids(tmp_path / "out")[1][0][1]


def test_what_was_done_before_ctrl_c_is_kept(bag, tmp_path, monkeypatch):
    identify, done = Identification.identify, []

    def stop_at_the_fourth(self, *parts):
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(1)
        return identify(self, *parts)

    monkeypatch.setattr(Identification, "identify", stop_at_the_fourth)
    given = [str(bag), str(tmp_path / "out"), "--image", "/camera/image"]
    kept = ["--instances", "/detector/instances", "--save", str(tmp_path / "memory")]
    assert main([*given, *kept]) == 130
    assert len(read_ids(tmp_path / "out")[1]) == 3
    assert (tmp_path / "memory").exists()


def test_messages_without_a_stamp_are_told(tmp_path):
    write_bag(tmp_path / "in", [(0, messages.scene(0))])
    done = identify_bag(tmp_path / "in", tmp_path / "out", TOPICS)
    assert done.num_images == 0
    assert len(done.refused) == 2
    assert all("header.stamp" in why for why in done.refused)


def test_what_cannot_be_done_is_said(bag, tmp_path, capsys):
    with pytest.raises(SourceError, match="has no topic '/other'; its topics: /camera/image"):
        identify_bag(bag, tmp_path / "out", BagTopics("/camera/image", detections="/other"))
    with pytest.raises(SourceError, match="name a topic"):
        identify_bag(bag, tmp_path / "out", BagTopics("/camera/image"))
    other = BagTopics("/camera/image", detections="/detector/instances")
    with pytest.raises(SourceError, match=r"instances' of .* holds sensor_msgs/msg/Image; name"):
        identify_bag(bag, tmp_path / "out", other)
    with pytest.raises(SourceError, match="no bag that can be read"):
        identify_bag(tmp_path / "nothing", tmp_path / "out", TOPICS)
    (tmp_path / "there").mkdir()
    with pytest.raises(OutputError, match="there cannot be written"):
        identify_bag(bag, tmp_path / "there", TOPICS)
    given = [str(bag), str(tmp_path / "x"), "--image", "/camera/image"]
    assert main(given) == 1
    assert capsys.readouterr().err.startswith("error: name a topic")
    given += ["--instances", "/detector/instances", "--save", str(tmp_path / "none" / "memory")]
    assert main(given) == 1
    assert "there is no folder" in capsys.readouterr().err
    assert not any((tmp_path / name).exists() for name in ("out", "x"))
