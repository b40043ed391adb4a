import collections
import dataclasses

import numpy as np
import pytest

import remind_jax as rj
from remind_jax.errors import SourceError
from remind_jax.outputs.drawing import NO_IMAGE_GRAY, identity_color
from remind_jax.outputs.overlay import draw_overlay, find_trails
from remind_jax.tracks import Tracks
from tests.outputs.fake_run import make_tracks

SIZE = (120, 200)
IMAGE = np.full((*SIZE, 3), 100, np.uint8)


def seen(index: int, **places: int) -> Tracks:
    """A frame with squares of 20 pixels, 50 below the top; `o3=40` is object 3 at column 40."""
    masks = np.zeros((len(places), *SIZE), bool)
    for mask, left in zip(masks, places.values(), strict=True):
        mask[50:70, left : left + 20] = True
    return make_tracks(index, masks, [{"object_id": int(name[1:])} for name in places])


def ways(tracks: Tracks, earlier: list[Tracks]) -> dict[int, list[list[float]]]:
    found = find_trails(tracks, earlier)
    return {i: [[float(c[0]) for c in piece] for piece in pieces] for i, pieces in found.items()}


def test_centers_are_joined_in_order():
    earlier = [seen(0, o3=20), seen(1, o3=40, o5=100)]
    assert ways(seen(2, o3=60), earlier) == {3: [[30, 50, 70]]}
    assert find_trails(seen(2, o3=60), earlier)[3][0][0].tolist() == [30, 60]


def test_no_line_leads_across_an_absence():
    earlier = [seen(0, o3=20), seen(1, o3=40), seen(2, o5=0), seen(3, o3=90)]
    assert ways(seen(4, o3=100), earlier) == {3: [[30, 50], [100, 110]]}


def test_frames_that_are_not_earlier_are_left_out():
    frames = [seen(i, o3=20 * i) for i in range(4)]
    assert ways(frames[2], frames) == {3: [[10, 30, 50]]}


def test_undecided_detections_have_no_way():
    assert ways(seen(1, o3=0), []) == {3: [[10]]}
    nobody = dataclasses.replace(seen(1, o3=0), object_id=np.array([-1]))
    assert ways(nobody, [seen(0, o3=0)]) == {}


def test_draw_shows_the_way_in_the_color_of_the_identity():
    recent = collections.deque([seen(0, o3=20), seen(1, o3=80)], maxlen=30)
    now = seen(2, o3=150)
    without, drawn = rj.draw(IMAGE, now), rj.draw(IMAGE, now, trails=recent)
    np.testing.assert_array_equal(without, draw_overlay(IMAGE, now))
    changed = (without != drawn).any(axis=-1)
    rows, columns = np.nonzero(changed)
    assert 56 <= rows.min() < 60 <= rows.max() <= 63  # a thin line at the height of the centers
    assert columns.min() <= 30  # from the oldest center
    assert (drawn[59:61, 60] == identity_color(3)).all(-1).any()
    assert (IMAGE == 100).all()  # the input is not written to


def test_draw_without_an_image_is_gray():
    drawn = rj.draw(None, seen(0, o3=20))
    assert drawn.shape == (*SIZE, 3)
    assert (drawn[-1] == NO_IMAGE_GRAY).all()


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: rj.draw(IMAGE[:60], seen(0, o3=0)), "image is 200x60, its tracks .* 200x120"),
        (lambda: rj.draw(IMAGE / 255, seen(0, o3=0)), "the frame is float64"),
        (lambda: rj.draw("a", seen(0, o3=0)), "the frame is"),
        (lambda: rj.draw(IMAGE, None), "tracks are of type NoneType"),
        (lambda: rj.draw(IMAGE, seen(0, o3=0), trails=True), "tracks are of type bool"),
        (lambda: rj.draw(IMAGE, seen(0, o3=0), trails=[3]), "tracks are of type int"),
    ],
)
def test_other_things_are_refused(call, sentence):
    with pytest.raises(SourceError, match=sentence):
        call()
