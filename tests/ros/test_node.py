"""The node over a stand-in for `rclpy` that calls back at once."""

import importlib
import sys
import threading
import types
from typing import Any

import pytest

from remind_jax.errors import SourceError
from remind_jax.session.announcement import DETECTOR_DEFAULT
from remind_jax.session.live import Tracker
from tests.ros import messages

WAIT_S = 300  # the first image waits for a compilation


class StandInNode:
    """Keeps what is subscribed, published, offered and logged."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        self.parameters = parameters
        self.subscribed: dict[str, Any] = {}
        self.published: dict[str, list[Any]] = {}
        self.services: dict[str, Any] = {}
        self.logged: list[str] = []
        self.changed = threading.Condition()

    def declare_parameter(self, name: str, value: Any) -> Any:
        return types.SimpleNamespace(value=self.parameters.get(name, value))

    def create_subscription(self, kind: Any, topic: str, callback: Any, _: Any) -> None:
        self.subscribed[topic] = (kind, callback)

    def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
        assert depth > 0
        said = self.published[topic] = []

        def publish(message: Any) -> None:
            assert isinstance(message, kind)
            with self.changed:
                said.append(message)
                self.changed.notify_all()

        return types.SimpleNamespace(publish=publish)

    def create_service(self, kind: Any, topic: str, answer: Any) -> None:
        self.services[topic] = (kind, answer)

    def get_logger(self) -> Any:
        def log(text: str, **_: Any) -> None:
            with self.changed:
                self.logged.append(text)
                self.changed.notify_all()

        return types.SimpleNamespace(info=log, warning=log, error=log, fatal=log)

    def destroy_node(self) -> None:
        pass

    def receive(self, topic: str, message: Any) -> None:
        kind, callback = self.subscribed[topic]
        assert isinstance(message, kind)
        callback(message)

    def wait_for(self, condition: Any) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, WAIT_S)

    def call(self, topic: str, **request: Any) -> tuple[bool, str]:
        answered = types.SimpleNamespace(success=None, message=None)
        response = self.services[topic][1](types.SimpleNamespace(**request), answered)
        return response.success, response.message


@pytest.fixture
def install(monkeypatch):
    """Makes a stand-in for a node with parameters; gives it and the module of the node."""

    def begin(**parameters: Any) -> tuple[StandInNode, Any]:
        stand_in, is_over = StandInNode(parameters), threading.Event()
        parts: dict[str, dict[str, Any]] = {
            "rclpy": {
                "create_node": lambda name: stand_in,
                "init": is_over.clear,
                "ok": lambda: not is_over.is_set(),
                "spin": lambda node: is_over.wait(WAIT_S),
                "try_shutdown": is_over.set,
            },
            "rclpy.executors": {"ExternalShutdownException": type("Ended", (Exception,), {})},
            "rclpy.logging": {"get_logger": lambda name: stand_in.get_logger()},
            "rclpy.qos": {"qos_profile_sensor_data": object()},
        }
        for name, content in parts.items():
            module = types.ModuleType(name)
            vars(module).update(content)
            monkeypatch.setitem(sys.modules, name, module)
        packages: dict[str, types.ModuleType] = {}
        for kind, cls in messages.TYPES.types.items():
            package, _, name = kind.split("/")
            module = packages.setdefault(package, types.ModuleType(f"{package}.msg"))
            setattr(module, name, cls)
        for package, module in packages.items():
            monkeypatch.setitem(sys.modules, f"{package}.msg", module)
        for kind in ("std_srvs/Trigger", "interfaces/UseMemory", "interfaces/RenameObject"):
            package, name = kind.replace("interfaces", "remind_ros_interfaces").split("/")
            module = sys.modules.get(f"{package}.srv") or types.ModuleType(f"{package}.srv")
            setattr(module, name, type(name, (), {}))
            monkeypatch.setitem(sys.modules, f"{package}.srv", module)
        monkeypatch.delitem(sys.modules, "remind_ros.node", raising=False)
        node = importlib.import_module("remind_ros.node")
        monkeypatch.setattr(node, "make_ros_message", messages.make)
        return stand_in, node

    return begin


@pytest.fixture
def start(install):
    """Starts the node with parameters; gives the stand-in and the node."""
    started = []

    def begin(**parameters: Any) -> tuple[StandInNode, Any]:
        stand_in, node = install(**parameters)
        identity_node = node.IdentityNode()
        started.append(identity_node)
        return stand_in, identity_node

    yield begin
    for identity_node in started:
        identity_node.close()


def send(node: StandInNode, index: int) -> None:
    picture, numbers = messages.scene(index)
    stamp = 1_000_000_000 + 100_000_000 * index
    node.receive("~/image", messages.image(picture, "rgb8", stamp))
    node.receive("~/instances", messages.image(numbers, "16UC1", stamp))


def show(node: StandInNode, index: int) -> None:
    before = len(node.published["~/detections"])
    send(node, index)
    node.wait_for(lambda: len(node.published["~/detections"]) > before)


WITH_MAPS = {"use_instances": True, "use_detections": False}


def test_images_are_answered(start):
    node, _ = start(**WITH_MAPS)
    for index in range(3):
        show(node, index)
    ids = [[one.id for one in said.detections] for said in node.published["~/detections"]]
    assert ids == [ids[0]] * 3
    assert all(ids[0])
    stamps = [said.header.stamp.nanosec for said in node.published["~/identities"]]
    assert stamps == [0, 100_000_000, 200_000_000]


def test_memory_is_kept_between_starts(start, tmp_path):
    kept = str(tmp_path / "memory")
    node, identity_node = start(**WITH_MAPS, memory=kept)
    assert "starting with an empty memory" in node.logged[0]
    for index in range(10):
        show(node, index)
    ids = [one.id for one in node.published["~/detections"][-1].detections]
    assert node.call("~/rename", id=ids[0], name="my mug")[0]
    identity_node.close()
    assert node.logged[-1] == f"2 objects were written to {kept}"
    again, _ = start(**WITH_MAPS, memory=kept)
    show(again, 11)
    assert [one.id for one in again.published["~/detections"][-1].detections] == ids


def test_what_another_program_wrote_stays_when_the_node_ends(start, tmp_path):
    kept = tmp_path / "memory"
    node, identity_node = start(**WITH_MAPS, memory=str(kept))
    show(node, 0)
    identity_node.close()
    node, identity_node = start(**WITH_MAPS, memory=str(kept))
    show(node, 1)
    other = Tracker()
    other.load(kept)
    other.rename(0, "precious")
    other.save(kept)
    identity_node.close()
    other.load(kept)
    assert other.objects()[0].name == "precious"
    (aside,) = tmp_path.glob("memory.*")
    assert "changed by another program" in node.logged[-1]
    assert str(aside) in node.logged[-1]
    other.load(aside)
    assert int(other.state.frame) == 2


def test_after_a_reset_the_next_start_knows_nothing(start, tmp_path):
    kept = tmp_path / "memory"
    node, identity_node = start(**WITH_MAPS, memory=str(kept))
    for index in range(10):
        show(node, index)
    assert node.call("~/save", path="")[0]
    success, message = node.call("~/reset")
    assert success
    (aside,) = tmp_path.glob("memory.*")
    assert message == f"2 objects were forgotten; what '{kept}' knew is in '{aside}'"
    identity_node.close()
    node, identity_node = start(**WITH_MAPS, memory=str(kept))
    assert "starting with an empty memory" in node.logged[0]
    for index in range(10):
        show(node, index)
    assert node.call("~/reset")[0]
    show(node, 10)
    identity_node.close()
    assert kept.exists()  # of what came after


def test_images_without_detections_are_told(start):
    node, _ = start(**WITH_MAPS)
    picture, _ = messages.scene(0)
    for index in range(1, 62):
        node.receive("~/image", messages.image(picture, "rgb8", index))
    assert "messages of '~/image' go unanswered" in node.logged[-1]


def test_every_class_id_needs_its_name(start):
    with pytest.raises(SourceError, match="differ in length"):
        start(**WITH_MAPS, class_ids=["0", "1"], class_names=["mug"])


def test_a_refused_memory_ends_the_start_and_stays(install, tmp_path):
    kept = tmp_path / "memory"
    kept.write_bytes(b"cut off")
    stand_in, node = install(**WITH_MAPS, memory=str(kept))
    assert node.main() == 1
    (why,) = stand_in.logged
    assert str(kept) in why
    assert kept.read_bytes() == b"cut off"


def test_memory_is_kept_while_the_node_runs(start, tmp_path):
    kept = tmp_path / "folder" / "memory"
    node, _ = start(**WITH_MAPS, memory=str(kept), checkpoint_s=1e-6)
    show(node, 0)
    node.wait_for(lambda: len(node.logged) == 2)  # there is no such folder
    assert "folder" in node.logged[1]
    kept.parent.mkdir()
    for index in range(1, 3):  # the first is done with when the second is answered
        show(node, index)
    again = Tracker()
    again.load(kept)
    assert int(again.state.frame) >= 2


def test_no_checkpoints_without_seconds_between(start, tmp_path):
    kept = tmp_path / "memory"
    node, identity_node = start(**WITH_MAPS, memory=str(kept), checkpoint_s=0.0)
    for index in range(2):
        show(node, index)
    assert not kept.exists()
    identity_node.close()
    assert kept.exists()


def test_what_nobody_foresaw_ends_the_node_with_its_memory_kept(install, monkeypatch, tmp_path):
    kept = tmp_path / "memory"
    stand_in, node = install(**WITH_MAPS, memory=str(kept))
    codes = []
    spinning = threading.Thread(target=lambda: codes.append(node.main()))
    spinning.start()
    stand_in.wait_for(lambda: "~/rename" in stand_in.services)
    show(stand_in, 0)
    monkeypatch.setattr(node.Identification, "identify", lambda *_: 1 // 0)
    send(stand_in, 1)
    spinning.join(WAIT_S)
    assert codes == [1]
    assert any("ZeroDivisionError" in text for text in stand_in.logged)
    assert kept.exists()


@pytest.mark.parametrize(
    ("parameters", "after"),
    [
        ({"use_detections": True}, DETECTOR_DEFAULT),
        ({"use_detections": True, "use_instances": True}, DETECTOR_DEFAULT),
        (WITH_MAPS, 1),
        ({"announce_after": 3}, 3),
    ],
)
def test_objects_of_a_detector_get_their_id_late(start, parameters, after):
    _, identity_node = start(**parameters)
    assert identity_node._identification.tracker.announce_after == after


def test_messages_without_a_stamp_are_left_out_and_told(start):
    node, _ = start(**WITH_MAPS)
    picture, _ = messages.scene(0)
    node.receive("~/image", messages.image(picture))
    (why,) = node.logged
    assert "'~/image'" in why
    assert "header.stamp" in why
    show(node, 1)


def test_services_say_what_they_did(start, tmp_path):
    node, _ = start(**WITH_MAPS)
    success, message = node.call("~/save", path=str(tmp_path / "memory"))
    assert not success
    assert "before the first frame" in message
    for index in range(10):
        show(node, index)
    assert node.call("~/save", path="") == (False, "name a path, or set the parameter 'memory'")
    assert node.call("~/save", path=str(tmp_path / "memory"))[0]
    assert node.call("~/reset") == (True, "2 objects were forgotten")
    success, message = node.call("~/load", path=str(tmp_path / "memory"))
    assert success
    assert message.startswith("2 objects were read")
    assert not node.call("~/rename", id="99", name="mug")[0]


def test_bad_images_are_left_out_and_told(start):
    node, _ = start(**WITH_MAPS)
    picture, numbers = messages.scene(0)
    node.receive("~/image", messages.image(picture, "rgb8", 1))
    node.receive("~/instances", messages.image(numbers[:9], "16UC1", 1))
    node.wait_for(lambda: node.logged)
    assert "256x9 pixels" in node.logged[0]
    show(node, 1)


def test_a_busy_tracker_skips_images(start):
    node, identity_node = start(**WITH_MAPS)
    show(node, 0)
    identity_node._lock.acquire()  # as if one image took long
    try:
        for index in range(1, 6):
            send(node, index)
    finally:
        identity_node._lock.release()
    node.wait_for(lambda: node.published["~/identities"][-1].header.stamp.nanosec == 500_000_000)
    last = node.published["~/identities"][-1]
    assert len(node.published["~/identities"]) + last.images_skipped == 6
    assert last.images_skipped >= 3


def test_something_must_be_detected(start):
    with pytest.raises(SourceError, match="set use_instances, use_detections"):
        start(use_instances=False, use_detections=False)
