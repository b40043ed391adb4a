import dataclasses

import numpy as np
import pytest

from remind_jax.decision import Outcome
from remind_jax.errors import SourceError
from remind_jax.session.live import Tracker
from remind_ros.definitions import DEFINITIONS
from remind_ros.identification import KNOWN, NEW, Identification
from tests.ros import messages
from tests.ros.conftest import ROS


@pytest.fixture(scope="module")
def tracker():
    return Tracker()


@pytest.fixture
def identification(tracker):
    tracker.reset()
    return Identification(messages.make, tracker)


def show(identification, index):
    picture, numbers = messages.scene(index)
    return identification.identify(messages.image(picture), messages.image(numbers, "16UC1"))


def test_the_same_object_has_the_same_id(identification):
    answers = [show(identification, index) for index in range(12)]
    ids = [[one.id for one in answer.detections.detections] for answer in answers]
    assert ids == [ids[0]] * 12
    assert len(set(ids[0])) == 2
    states = [[one.state for one in answer.identities.identities] for answer in answers]
    assert states == [[NEW, NEW]] + [[KNOWN, KNOWN]] * 11
    assert [answer.identities.objects_known for answer in answers] == [2] * 12
    last = answers[-1].identities
    assert [one.name for one in last.identities] == [f"object {i}" for i in ids[0]]


def test_messages_can_be_sent(identification):
    answer = show(identification, 0)
    for kind, said in (
        ("vision_msgs/msg/Detection2DArray", answer.detections),
        ("remind_ros_interfaces/msg/Identities", answer.identities),
    ):
        raw = messages.TYPES.serialize_cdr(said, kind)
        again = messages.TYPES.deserialize_cdr(raw, kind)
        assert messages.TYPES.serialize_cdr(again, kind) == raw
    box = answer.detections.detections[0].bbox
    place = box.center.position
    assert (place.x, place.y, box.size_x, box.size_y) == (48, 48, 80, 80)


def test_an_undecided_detection_names_what_it_may_be(identification, monkeypatch):
    show(identification, 0)
    update = identification.tracker.update

    def undecided(*args, **options):
        tracks = update(*args, **options)
        return dataclasses.replace(
            tracks,
            outcome=np.array([Outcome.AMBIGUOUS, Outcome.MATCH]),
            object_id=np.array([-1, 1]),
            candidate_id=np.array([[1, 0, -1], [-1, -1, -1]]),
            candidate_score=np.array([[0.5, 0.25, 0], [0, 0, 0]]),
        )

    monkeypatch.setattr(identification.tracker, "update", undecided)
    answer = show(identification, 1)
    detection = answer.detections.detections[0]
    assert detection.id == ""
    shown = [(r.hypothesis.class_id, r.hypothesis.score) for r in detection.results[1:]]
    assert shown == [("object 1", 0.5), ("object 0", 0.25)]
    identity = answer.identities.identities[0]
    assert (identity.id, list(identity.candidate_ids)) == ("", ["1", "0"])
    assert identity.candidate_scores.tolist() == [0.5, 0.25]
    assert len(answer.detections.detections[1].results) == 1


def test_objects_can_be_renamed(identification):
    known = show(identification, 0).detections.detections[0].id
    identification.rename(known, "my mug")
    assert show(identification, 1).identities.identities[0].name == "my mug"
    identification.rename(known, "")
    assert show(identification, 2).identities.identities[0].name == f"object {known}"
    for wrong in ("99", "-1", "mug", ""):
        with pytest.raises(SourceError, match=f"no object '?{wrong}"):
            identification.rename(wrong, "mine")


def test_classes_get_names(tracker):
    tracker.reset()
    identification = Identification(messages.make, tracker, {"3": "mug"})
    picture, _ = messages.scene(0)
    given = messages.boxes([(8, 8, 88, 88), (136, 8, 216, 88)], ["3", "bowl"])
    answer = identification.identify(messages.image(picture), boxes=given)
    assert [one.label for one in answer.identities.identities] == ["mug", "bowl"]
    assert np.isfinite([one.confidence for one in answer.identities.identities]).all()


def test_definitions_are_those_of_the_interface_package():
    for path in (ROS / "remind_ros_interfaces" / "msg").glob("*.msg"):
        lines = (line.partition("#")[0].split() for line in path.read_text().splitlines())
        stated = "\n".join(" ".join(words) for words in lines if words)
        known = DEFINITIONS[f"remind_ros_interfaces/msg/{path.stem}"]
        assert known.replace("remind_ros_interfaces/", "") == stated
