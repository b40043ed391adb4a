import numpy as np
import pytest

import remind_jax as rj
from remind_jax.errors import SourceError
from remind_jax.outputs.drawing import NO_IMAGE_GRAY
from remind_jax.outputs.overlay import draw_overlay
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


def test_the_input_is_not_written_to():
    tracks = seen(2, o3=150)
    np.testing.assert_array_equal(rj.draw(IMAGE, tracks), draw_overlay(IMAGE, tracks))
    assert (IMAGE == 100).all()


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
    ],
)
def test_other_things_are_refused(call, sentence):
    with pytest.raises(SourceError, match=sentence):
        call()
