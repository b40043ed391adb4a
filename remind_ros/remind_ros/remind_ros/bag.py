"""Identities for a recorded bag, without ROS: `identify_bag IN OUT --image /camera/image ...`."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

from remind_jax.errors import OutputError, RemindError, SourceError
from remind_jax.files import check_place
from remind_jax.session.live import Tracker
from remind_ros.definitions import add_types
from remind_ros.identification import Identification, make_tracker
from remind_ros.pairing import Pairing, slop_in_ns, stamp_ns

PUBLISHED = {
    "/remind/detections": "vision_msgs/msg/Detection2DArray",
    "/remind/identities": "remind_ros_interfaces/msg/Identities",
}


@dataclasses.dataclass(frozen=True)
class BagTopics:
    """Where a bag holds what; an empty name means that there is no such topic."""

    image: str  # sensor_msgs/Image or sensor_msgs/CompressedImage
    instances: str = ""  # sensor_msgs/Image, numbers of instances
    detections: str = ""  # vision_msgs/Detection2DArray

    @property
    def names(self) -> tuple[str, ...]:
        """Those that there are, that of the image first."""
        return tuple(name for name in dataclasses.astuple(self) if name)


@dataclasses.dataclass(frozen=True)
class BagSummary:
    """What became of a bag."""

    num_images: int  # that were answered
    num_detections: int
    num_objects: int  # in memory at the end, with an id
    complete: bool  # whether it was read to its end
    refused: tuple[str, ...]  # why images and messages were left out, one sentence each


def identify_bag(
    source: str | Path,
    target: str | Path,
    topics: BagTopics,
    tracker: Tracker | None = None,
    *,
    slop_s: float = 0.01,
) -> BagSummary:
    """Writes a bag with the identities of another one, at the times of its images.

    Args:
      source: A bag of ROS 1 or 2.
      target: A folder that does not exist yet; a bag of ROS 2 in MCAP.
      topics: What to read.
      tracker: With the configuration and the backbone to use; the default one if left out.
      slop_s: By how much stamps of one image may differ.

    Returns:
      After Ctrl-C, of the images so far.

    Raises:
      SourceError: If the bag cannot be read, lacks a topic, or has other messages there.
      OutputError: If the target is there already, or cannot be written.
    """
    if not (topics.instances or topics.detections):
        raise SourceError("name a topic with instance maps, with detections, or both")
    types = add_types()
    identification = Identification(from_store(types), tracker)
    pairing = Pairing(topics.names, slop_in_ns(slop_s))
    num_images, num_detections, refused, complete = 0, 0, [], False
    with _open(source, topics, types) as reader, _create(target) as writer:
        outlets = [
            (kind, writer.add_connection(topic, kind, typestore=types))
            for topic, kind in PUBLISHED.items()
        ]
        with contextlib.suppress(KeyboardInterrupt):  # the bag is closed as it should be
            for time_ns, parts in _read_sets(reader, pairing, topics, refused):
                try:
                    answer = identification.identify(*parts)
                except SourceError as error:
                    refused.append(f"image at {stamp_ns(parts[0])} ns: {error}")
                    continue
                num_images += 1
                num_detections += len(answer.tracks)
                said = (answer.detections, answer.identities)
                for (kind, outlet), message in zip(outlets, said, strict=True):
                    writer.write(outlet, time_ns, types.serialize_cdr(message, kind))
            complete = True
    num_objects = identification.num_objects
    return BagSummary(num_images, num_detections, num_objects, complete, tuple(refused))


@contextlib.contextmanager
def _open(source: str | Path, topics: BagTopics, types: Any) -> Iterator[AnyReader]:
    """The bag, if it can be read and has the topics."""
    if not (topics.instances or topics.detections):
        raise SourceError("name a topic with instance maps, with detections, or both")
    try:
        reader = AnyReader([Path(source)], default_typestore=types)
        reader.open()
    except (AnyReaderError, OSError) as error:
        raise SourceError(f"{source} is no bag that can be read: {error}") from error
    kinds = {
        topics.image: ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"),
        topics.instances: ("sensor_msgs/msg/Image",),
        topics.detections: ("vision_msgs/msg/Detection2DArray",),
    }
    try:
        if missing := sorted(set(topics.names) - set(reader.topics)):
            there = ", ".join(sorted(reader.topics)) or "none"
            raise SourceError(f"{source} has no topic '{missing[0]}'; its topics: {there}")
        for one in reader.connections:
            if one.topic in topics.names and one.msgtype not in kinds[one.topic]:
                raise SourceError(
                    f"topic '{one.topic}' of {source} holds {one.msgtype}; name one that holds "
                    f"{' or '.join(kinds[one.topic])}"
                )
        add_types(reader.typestore)
        yield reader
    finally:
        reader.close()


@contextlib.contextmanager
def _create(target: str | Path) -> Iterator[Writer]:
    """A new bag."""
    try:
        with Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            yield writer
    except (WriterError, OSError) as error:
        raise OutputError(f"{target} cannot be written: {error}") from error


def _read_sets(
    reader: AnyReader, pairing: Pairing, topics: BagTopics, refused: list[str]
) -> Iterator[tuple[int, list[Any]]]:
    """Complete sets of image, instance map and detections, with the bag's time of the image, ns."""
    wanted = [one for one in reader.connections if one.topic in topics.names]
    for connection, time_ns, raw in reader.messages(wanted):
        message = reader.deserialize(raw, connection.msgtype)
        try:
            sets = pairing.add(connection.topic, stamp_ns(message), (time_ns, message))
        except SourceError as error:
            refused.append(f"message at {time_ns} ns: {error}")
            continue
        for found in sets:
            parts = [found.get(name, (0, None)) for name in dataclasses.astuple(topics)]
            yield parts[0][0], [part for _, part in parts]


def from_store(types: Any) -> Any:
    """Makes messages of the types of a `rosbags` store; headers are taken over as they are."""

    def make(kind: str, **fields: Any) -> Any:
        return types.types[kind](**fields)

    return make


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit code: 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(prog="identify_bag", description=__doc__)
    parser.add_argument("source", type=Path, metavar="IN", help="bag of ROS 1 or 2")
    parser.add_argument("target", type=Path, metavar="OUT", help="folder of the new bag")
    parser.add_argument("--image", required=True, metavar="TOPIC", help="images")
    parser.add_argument("--instances", default="", metavar="TOPIC", help="instance maps")
    parser.add_argument("--detections", default="", metavar="TOPIC", help="Detection2DArray")
    parser.add_argument("--config", default="default", help="name or YAML file")
    parser.add_argument("--backbone", default="patch-statistics", help="patch features")
    parser.add_argument("--announce-after", type=int, default=0, help="detections until an id")
    parser.add_argument("--load", type=Path, metavar="FILE", help="memory to go on from")
    parser.add_argument("--save", type=Path, metavar="FILE", help="where the memory is kept")
    parser.add_argument("--slop-s", type=float, default=0.01, help="between stamps of one image")
    given = parser.parse_args(arguments)
    topics = BagTopics(given.image, given.instances, given.detections)
    try:
        has_detector = bool(given.detections)
        tracker = make_tracker(given.config, given.backbone, given.announce_after, has_detector)
        if given.load is not None:
            tracker.load(given.load)
        if given.save is not None:
            check_place(given.save)
        done = identify_bag(given.source, given.target, topics, tracker, slop_s=given.slop_s)
        if given.save is not None:
            tracker.save(given.save)
    except RemindError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for why in done.refused[:5]:
        print(f"left out: {why}", file=sys.stderr)
    if len(done.refused) > 5:
        print(f"left out: {len(done.refused) - 5} more", file=sys.stderr)
    print(
        f"{done.num_detections} detections in {done.num_images} images; "
        f"{done.num_objects} objects in memory; written to {given.target}"
    )
    return 0 if done.complete else 130


if __name__ == "__main__":
    raise SystemExit(main())
