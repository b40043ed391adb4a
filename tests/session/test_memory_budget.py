"""What does not fit this machine is refused before it is compiled, and the memory goes on."""

import dataclasses
import math

import jax
import pytest

from remind_jax import method as methods
from remind_jax.errors import SourceError
from remind_jax.method import get_method
from remind_jax.session import machine_memory
from remind_jax.session.live import Tracker
from remind_jax.static import Static
from tests.session.test_live import frames

SMALL = {"num_detections": 1, "num_objects": 4, "num_pending": 4}


def test_a_frame_that_does_not_fit_is_refused_before_compilation_and_the_next_one_goes_on(
    monkeypatch,
):
    inner = get_method("bank")  # quick to compile; here it counts what a frame needs
    host = dataclasses.replace(inner.host, count_bytes=lambda static: 100 * static.num_detections)
    monkeypatch.setattr(methods, "_methods", dict(methods._methods))
    methods.register_method(dataclasses.replace(inner, name="counting", host=host))
    tracker = Tracker({"tracker": "counting", "static": SMALL})
    image, labels = frames(1)[0]
    few = labels * (labels == labels[labels > 0][0])
    before = tracker.update(image, few)
    room = 100 / machine_memory.BUDGET_SHARE
    monkeypatch.setattr(machine_memory, "device_bytes", lambda: int(room) + 1)
    with pytest.raises(SourceError, match=r"room for \d+ detections.*fewer detections"):
        tracker.update(image, labels)
    after = tracker.update(image, few)
    assert list(after.object_id) == list(before.object_id)
    assert tracker.static.num_detections == 1


def test_the_sentence_names_what_is_needed_and_what_may_be_used(monkeypatch):
    monkeypatch.setattr(machine_memory, "device_bytes", lambda: 8 * machine_memory.GIB)
    method = get_method("plus")
    many = Static(num_detections=512, num_objects=16_384, feature_dim=384)
    with pytest.raises(SourceError, match=r"16384 objects takes about 10\.5 GiB, and 6\.0 GiB"):
        machine_memory.check_room(method, many)
    machine_memory.check_room(method, dataclasses.replace(many, num_objects=4096))


def test_where_the_memory_is_not_known_all_is_tried(monkeypatch):
    monkeypatch.setattr(machine_memory, "device_bytes", lambda: 0)
    machine_memory.check_room(
        get_method("plus"), Static(num_detections=8192, num_objects=32_768, feature_dim=384)
    )


def test_the_memory_of_this_machine_is_known():
    assert machine_memory.device_bytes() > 2**28


@pytest.mark.parametrize("name", ["plus", "remind"])
def test_the_estimate_holds_the_memory_and_is_of_its_size(name):
    method = get_method(name)
    static = method.static(num_detections=16, num_objects=512, feature_dim=96)
    state = jax.eval_shape(lambda: method.init(static))
    num_bytes = sum(math.prod(leaf.shape) * leaf.dtype.itemsize for leaf in jax.tree.leaves(state))
    assert method.host.count_bytes is not None
    assert num_bytes <= method.host.count_bytes(static) <= 2 * num_bytes
