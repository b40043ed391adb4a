"""The compiled step: the results of `method.step`, and no more compilations than needed."""

import dataclasses
import functools
from unittest import mock

import jax
import numpy as np
import pytest

from remind_jax.compiled import frame_step
from remind_jax.compiled.frame_step import FrameInput, FrameStep
from remind_jax.compiled.programs import clear_programs
from remind_jax.method import get_method
from remind_jax.session.live import Tracker
from tests.cli import scenes
from tests.session.test_live import assert_same_answers

TINY = {"num_detections": 4, "num_objects": 6, "num_pending": 4}
HEAVY = pytest.mark.heavy
METHODS = (
    pytest.param("plus", marks=HEAVY),
    "running-mean",
    pytest.param("remind", marks=pytest.mark.slow),
)


def make(name: str, **options) -> Tracker:
    return Tracker({"tracker": name, "static": TINY}, **options)


@pytest.fixture
def compiled(monkeypatch):
    """Kinds of the programs that are asked for, in turn."""
    kinds, get = [], frame_step.get_program

    def note(recipe):
        kinds.append(recipe.name)
        return get(recipe)

    monkeypatch.setattr(frame_step, "get_program", note)
    return kinds


@pytest.mark.parametrize("name", METHODS)
def test_it_gives_what_the_step_gives(name):
    tracker, method = make(name), get_method(name)
    got = scenes.follow(tracker, range(3))
    state = method.init(dataclasses.replace(tracker.static))
    step = jax.jit(method.step, static_argnames="static")
    other = make(name)
    for index, expected in enumerate(got):
        captured = _input_of(other, index)
        masks, observed = captured.given.unpack()
        more = {} if observed is None else {"observed": observed}
        state = step(
            state, captured.frame_feats, masks, static=tracker.static,
            thresholds=captured.thresholds.unpack(), **more,
        )  # fmt: skip
        num = len(expected)
        np.testing.assert_array_equal(state.decisions.object_id[:num], expected.object_id)
        np.testing.assert_array_equal(state.decisions.outcome[:num], expected.outcome)
        # Two programs fuse other operations than one does.
        np.testing.assert_allclose(
            state.decisions.confidence[:num], expected.confidence, rtol=1e-4, atol=1e-5
        )


def _input_of(tracker: Tracker, index: int) -> FrameInput:
    """What the tracker gives to its step in a frame."""
    with mock.patch.object(
        tracker._memory, "frame_step", wraps=tracker._memory.frame_step
    ) as watched:
        tracker.update(*scenes.picture(index))
    return watched.describe.call_args.args[0]


def test_another_frame_size_compiles_the_description_only(compiled):
    tracker = make("bank")
    scenes.follow(tracker, range(3))
    assert compiled == ["describe", "decide"]
    image, labels = scenes.picture(3)
    tracker.update(image[:-32], labels[:-32])
    assert compiled == ["describe", "decide"] * 2  # the second "decide" is the one at hand
    description, decision, other, same = tracker._memory.frame_step.programs()
    assert decision is same
    assert description is not other


def test_more_objects_compile_the_decision_only(compiled):
    tracker = make("bank")
    image, labels = scenes.picture(0, (1, 2))
    tracker.update(image, labels)
    tracker._memory.grow(num_objects=7)
    tracker.update(image, labels)
    description, decision, same, other = tracker._memory.frame_step.programs()
    assert description is same
    assert decision is not other


@pytest.mark.parametrize("name", ["plus", pytest.param("remind", marks=pytest.mark.slow)])
def test_a_trace_changes_no_decision(name):
    plain, traced = Tracker(tracker=name), Tracker(tracker=name, trace=True)
    assert_same_answers(*(scenes.follow(one, range(3)) for one in (plain, traced)))
    assert traced.trace is not None
    assert plain.trace is None


@HEAVY
@pytest.mark.usefixtures("folder")
def test_programs_that_leave_a_trace_are_kept():
    traces = []
    for _ in range(2):  # made anew, and kept
        clear_programs()
        tracker = make("plus", trace=True)
        scenes.follow(tracker, range(2))
        traces.append(tracker.trace)
        _, decision = tracker._memory.frame_step.programs()
    assert decision.structure is None
    jax.tree.map(np.testing.assert_array_equal, *traces)


@HEAVY
@pytest.mark.usefixtures("folder")
def test_after_a_warm_up_nothing_is_traced_to_ask_what_a_frame_showed(monkeypatch):
    for _ in range(2):  # made anew, and kept
        clear_programs()
        tracker = make("plus")
        tracker.warm_up(scenes.picture(0)[0].shape[:2])
    given = _input_of(tracker, 0)
    described = tracker._memory.frame_step.describe(given, tracker.static)
    monkeypatch.setattr(jax, "eval_shape", None)
    assert described.seen is not None


def test_a_method_that_is_defined_anew_is_compiled_anew():
    """As a notebook cell does: the same name, another function."""

    def shifted(by: int) -> Tracker:
        tracker = make("running-mean")
        method = tracker.method

        def decide(state, seen, **options):
            after, trace = method.decide(state, seen, **options)
            ids = after.decisions.object_id + by
            decisions = dataclasses.replace(after.decisions, object_id=ids)
            return dataclasses.replace(after, decisions=decisions), trace

        tracker._memory.frame_step = FrameStep(dataclasses.replace(method, decide=decide))
        return tracker

    first, second = (scenes.follow(shifted(by), [0])[0].object_id for by in (100, 200))
    assert (second - first == 100).all()


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Shifted:
    seen: object
    by: int = dataclasses.field(metadata={"static": True})


def _describe_shifted(*args, by, **options):
    return Shifted(get_method("running-mean").describe(*args, **options), by)


def _decide_shifted(state, shifted, **options):
    after, trace = get_method("running-mean").decide(state, shifted.seen, **options)
    decisions = dataclasses.replace(
        after.decisions, object_id=after.decisions.object_id + shifted.by
    )
    return dataclasses.replace(after, decisions=decisions), trace


def test_what_a_frame_looks_like_may_hold_more_than_arrays():
    def first_ids(by: int) -> np.ndarray:
        tracker = make("running-mean")
        describe = functools.partial(_describe_shifted, by=by)
        method = dataclasses.replace(tracker.method, describe=describe, decide=_decide_shifted)
        tracker._memory.frame_step = FrameStep(method)
        return scenes.follow(tracker, [0])[0].object_id

    np.testing.assert_array_equal(first_ids(200), first_ids(100) + 100)


def test_how_an_own_method_counts_its_slots_is_no_other_ones():
    def occupied_of(num: int) -> int:
        tracker = make("running-mean")
        host = dataclasses.replace(tracker.method.host, occupied=lambda state: (num, 0))
        method = dataclasses.replace(tracker.method, host=host)
        tracker._memory.frame_step = FrameStep(method)
        with mock.patch.object(tracker._memory, "_look_ahead") as told:
            scenes.follow(tracker, [0])
        return int(told.call_args.args[2][0])

    assert [occupied_of(num) for num in (2, 3)] == [2, 3]
