"""Growth: foreseen from its pace, prepared in the background, never a part of the result."""

from __future__ import annotations

import dataclasses
import sys
import threading

import pytest

from remind_jax.compiled.ahead import (
    SETTLED_FRAMES,
    SETTLED_S,
    SHORTEST_S,
    Forecast,
    Preparation,
    holds,
)
from remind_jax.static import Static

STATIC = Static(num_detections=16, num_objects=64, num_pending=32)
pytestmark = pytest.mark.usefixtures("looks_ahead")


def forecast(*samples: tuple[float, int], detections: int = 1, pending: int = 0) -> Static:
    seen = Forecast()
    for time_s, objects in samples:
        seen.add(
            time_s,
            {"num_detections": detections, "num_objects": objects, "num_pending": pending},
        )
    return seen.needed(STATIC)


def test_nothing_is_needed_while_there_is_room():
    assert Forecast().needed(STATIC) == STATIC
    assert forecast((0.0, 10)) == STATIC
    assert forecast((0.0, 40), (100.0, 41)) == STATIC


def test_a_capacity_that_is_nearly_full_grows():
    assert forecast((0.0, 48)).num_objects == 128
    assert forecast((0.0, 1), detections=12).num_detections == 32
    assert forecast((0.0, 1), pending=24).num_pending == 64


def test_a_quick_pace_is_foreseen_long_before():
    steady = [(second / 2, second) for second in range(25)]  # two objects a second
    assert forecast(*steady).num_objects == 128
    assert forecast(*((time, count // 8) for time, count in steady)) == STATIC


def test_what_is_met_at_once_is_no_pace():
    assert forecast((0.0, 0), (SHORTEST_S / 2, 20)) == STATIC


def test_what_is_sure_to_be_needed_is_prepared_whatever_is_planned():
    preparation, done = Preparation(), []
    reserve, exact = STATIC.grow(num_objects=256, num_pending=64), STATIC.grow(num_pending=64)
    preparation.plan([STATIC, reserve])
    preparation.start(exact, done.append)
    preparation.finish()
    assert (done, preparation.room_for(exact)) == ([], reserve)
    preparation.start(STATIC.grow(num_objects=128, num_pending=64), done.append, is_sure=True)
    preparation.finish()
    assert done == []  # the reserve is at most twice as large
    preparation.start(exact, done.append, is_sure=True)
    preparation.finish()
    assert (done, preparation.room_for(exact)) == ([exact], exact)


def test_a_plan_may_cover_more_than_is_at_hand():
    preparation, done = Preparation(), []
    preparation.plan([STATIC], covered=STATIC.grow(num_objects=512))
    preparation.start(STATIC.grow(num_objects=512), done.append)
    preparation.finish()
    assert done == []
    preparation.start(STATIC.grow(num_objects=1024), done.append)
    preparation.finish()
    assert done == [STATIC.grow(num_objects=1024)]


def test_what_stays_is_sure_once_it_is_there():
    def is_sure(objects: int, pending: int, detections: int = 1) -> bool:
        seen = Forecast()
        names = ("num_objects", "num_pending", "num_detections")
        seen.add(0.0, dict(zip(names, (objects, pending, detections), strict=True)))
        return seen.is_sure(STATIC)

    assert not Forecast().is_sure(STATIC)
    assert not is_sure(47, 23, 16)  # detections come and go
    assert is_sure(48, 0)
    assert is_sure(0, 24)


def test_an_old_pace_is_forgotten():
    early = [(second / 2, second) for second in range(40)]
    late = [(20.0 + second, 40) for second in range(60)]
    assert forecast(*early, *late) == STATIC


def test_a_stream_is_settled_after_a_while():
    seen = Forecast()
    assert not seen.is_settled
    occupied = {"num_detections": 1, "num_objects": 1, "num_pending": 0}
    for time_s in range(100, 100 + int(SETTLED_S)):
        seen.add(float(time_s), occupied)
        assert not seen.is_settled
    seen.add(100 + SETTLED_S, occupied)
    assert seen.is_settled


def test_a_quick_stream_is_settled_after_some_frames():
    seen = Forecast()
    occupied = {"num_detections": 1, "num_objects": 1, "num_pending": 0}
    for index in range(SETTLED_FRAMES):
        assert not seen.is_settled
        seen.add(index / 1000, occupied)
    assert seen.is_settled


def test_few_samples_are_kept_however_many_frames_there_are():
    seen = Forecast()
    for index in range(10_000):
        seen.add(index / 1000, {"num_detections": 1, "num_objects": 1, "num_pending": 0})
    assert len(seen._past) < 200


def test_holds_compares_capacities_only():
    large = STATIC.grow(num_objects=65)
    assert holds(large, STATIC)
    assert not holds(STATIC, large)
    assert not holds(dataclasses.replace(large, part_top=2), STATIC)


def test_what_is_prepared_is_at_hand_when_it_is_needed():
    gate, larger = threading.Event(), STATIC.grow(num_objects=65, num_detections=17)
    preparation, prepared = Preparation(), []

    def prepare(static: Static) -> None:
        gate.wait()
        prepared.append(static)

    preparation.start(larger, prepare)
    preparation.start(larger.grow(num_objects=200), prepare)  # one at a time
    gate.set()
    # Waits, as it holds what is needed, and more.
    assert preparation.room_for(STATIC.grow(num_objects=65)) == larger
    assert prepared == [larger]
    preparation.start(larger, prepare)
    preparation.finish()
    assert prepared == [larger]
    assert preparation.room_for(STATIC.grow(num_detections=17)) == larger


def test_the_least_that_suffices_is_taken():
    preparation = Preparation()
    for count in (500, 65, 200):
        preparation.start(STATIC.grow(num_objects=count), lambda static: None)
        preparation.finish()
    needed = STATIC.grow(num_objects=65)
    assert preparation.room_for(needed) == needed
    assert preparation.room_for(STATIC.grow(num_objects=129)).num_objects == 256


def test_what_was_planned_is_not_prepared_again():
    preparation, tries = Preparation(), []
    ready = [STATIC, STATIC.grow(num_objects=65), STATIC.grow(num_objects=129, num_pending=33)]
    preparation.plan(ready)
    preparation.start(STATIC.grow(num_pending=33), tries.append)  # held by the last
    assert preparation.room_for(STATIC.grow(num_objects=65)) == ready[1]
    assert preparation.room_for(STATIC.grow(num_pending=33)) == ready[2]
    assert tries == []
    preparation.start(STATIC.grow(num_objects=257), tries.append)
    preparation.finish()
    assert tries == [STATIC.grow(num_objects=257)]


def test_nobody_waits_for_too_little():
    preparation, gate = Preparation(), threading.Event()
    preparation.start(STATIC.grow(num_objects=65), lambda static: gate.wait())
    needed = STATIC.grow(num_objects=500)
    assert preparation.room_for(needed) == needed
    gate.set()


def test_a_failure_is_not_tried_again_and_left_to_the_frame_that_needs_it():
    preparation, larger, tries = Preparation(), STATIC.grow(num_objects=65), []

    def fail(static: Static) -> None:
        tries.append(static)
        raise MemoryError

    for _ in range(2):
        preparation.start(larger, fail)
        assert preparation.room_for(larger) == larger
    assert len(tries) == 1


def test_turns_are_short_while_anything_is_prepared():
    usual, gates = sys.getswitchinterval(), [threading.Event(), threading.Event()]
    preparations = [Preparation(), Preparation()]
    larger = STATIC.grow(num_objects=65)
    started = threading.Semaphore(0)

    def prepare(gate: threading.Event) -> None:
        started.release()
        gate.wait()

    for preparation, gate in zip(preparations, gates, strict=True):
        preparation.start(larger, lambda static, gate=gate: prepare(gate))
        started.acquire()
    assert sys.getswitchinterval() < usual
    gates[0].set()
    preparations[0].finish()
    assert sys.getswitchinterval() < usual
    gates[1].set()
    preparations[1].finish()
    assert sys.getswitchinterval() == pytest.approx(usual)
