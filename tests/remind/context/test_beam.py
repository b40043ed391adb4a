"""One class after the other: which rows a beam has, what they share, and how they are rated."""

import functools

import jax
import numpy as np
import pytest

from remind_jax.remind.context.beam import Beam, empty_beam, expand_by_class
from remind_jax.remind.context.evidence import join_links
from remind_jax.remind.context.frame_classes import group_by_class
from remind_jax.remind.context.set_score import FrameScale, rate_sizes
from tests.statics import make_static

from .scenes import Scene, example, read_view, thresholds

pytestmark = pytest.mark.usefixtures("x64")
NUM, SLOTS = 3, 5
STATIC = make_static(precision="float64", beam_width=10)


@functools.partial(jax.jit, static_argnames="static")
def _prepare(scene, t, static):
    view = read_view(scene, t, static)
    classes = group_by_class(view, static, t.sets)
    links = join_links(view, np.int32(1), static, t.sets)
    total = np.sum(view.det_valid, dtype=np.int32)
    scale = FrameScale(total, np.int32(0), rate_sizes(NUM, total, t.sets))
    return classes, scale, view, links


_expand = jax.jit(expand_by_class, static_argnames="static")


def small_example(**changed) -> Scene:
    """method.md#example-company in few slots."""
    scene = example()
    fields = {name: getattr(scene, name) for name in scene.__dataclass_fields__}
    for name, value in fields.items():
        sizes = [SLOTS if size > 12 else NUM for size in value.shape]
        fields[name] = value[tuple(slice(size) for size in sizes)]
    return Scene(**{**fields, **changed})


def walk(scene: Scene) -> list[Beam]:
    """The beam after every class."""
    t = thresholds()
    classes, scale, view, links = _prepare(scene, t, static=STATIC)
    beams = [empty_beam(NUM, SLOTS, STATIC)]
    for step in range(int(classes.num)):
        beams.append(
            _expand(beams[-1], classes, np.int32(step), scale, view, links, static=STATIC, t=t.sets)
        )
    return jax.device_get(beams[1:])


def list_rows(beam: Beam) -> list[tuple[set[int], set[int], float]]:
    """Objects, detections and score of each row in use."""
    return [
        (
            set(np.flatnonzero(beam.sets.members[beam.set_of[row]]).tolist()),
            set(np.flatnonzero(beam.detections[row]).tolist()),
            float(beam.rating.score[beam.set_of[row]]),
        )
        for row in np.flatnonzero(beam.valid)
    ]


def test_nothing_is_chosen_at_first():
    beam = empty_beam(NUM, SLOTS, STATIC)
    assert list_rows(jax.device_get(beam)) == [(set(), set(), 0.0)]
    assert beam.num_sets == 1


def test_beam_of_the_worked_example():
    """method.md#example-company: classes c0 and c2 have one object each, c1 has two.

    The twelve children of the last class are more than the beam holds.
    """
    first, second, third = walk(small_example())
    assert [(objects, dets) for objects, dets, _ in list_rows(first)] == [
        ({0}, {0}),
        (set(), set()),
    ]
    assert [objects for objects, *_ in list_rows(second)] == [{0, 3}, {0}, {3}, set()]
    rows = list_rows(third)
    assert len(rows) == third.num_sets == 10
    assert rows[0][:2] == ({0, 1, 3}, {0, 1, 2})
    assert rows[1][:2] == ({0, 3}, {0, 2})
    scores = [score for *_, score in rows]
    assert scores == sorted(scores, reverse=True)
    np.testing.assert_allclose(scores[:2], [0.632158, 0.423142], atol=1e-6)
    best = third.set_of[0]
    np.testing.assert_allclose(third.rating.density[best], 0.764706, atol=1e-6)
    np.testing.assert_allclose(third.rating.maturity[best], 0.776870, atol=1e-6)
    tally = jax.tree.map(lambda leaf: leaf[best], third.rating.tally)
    told = tally.support_sum / tally.support_weight, tally.stability_sum / 3
    np.testing.assert_allclose(told, (0.529412, 0.876256), atol=1e-6)
    np.testing.assert_allclose(tally.exclusivity_sum / 3, 0.974359, atol=1e-6)


def two_alike() -> Scene:
    """Three detections of one class, of which two objects are known."""
    return small_example(
        object_class=np.array([0, 0, -1, -1, -1], np.int32), det_class=np.zeros(NUM, np.int32)
    )


def test_rows_that_differ_in_detections_share_a_set():
    """The surest two detections are the last ones; one of them may give way to the first."""
    (beam,) = walk(two_alike())
    rows = [(objects, dets) for objects, dets, _ in list_rows(beam)]
    assert rows[0] == ({0, 1}, {1, 2})  # the best of the largest count comes first
    assert sorted(map(str, rows[1:])) == sorted(
        map(
            str,
            [
                ({0, 1}, {0, 2}),
                ({0}, {2}),
                ({0}, {1}),
                ({1}, {2}),
                ({1}, {1}),
                (set(), set()),
            ],
        )
    )
    assert beam.num_sets == 4
    shared = [tuple(objects) for objects, _ in rows]
    assert len(set(shared)) == len(set(beam.set_of[beam.valid].tolist()))
