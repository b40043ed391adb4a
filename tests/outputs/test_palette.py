import itertools

import numpy as np

from remind_jax.outputs.palette import identity_color, ink_on, to_hex


def test_colors_are_stable_and_valid():
    for object_id in range(500):
        color = identity_color(object_id)
        assert color == identity_color(object_id)
        assert all(0 <= channel <= 255 for channel in color)
        assert len(to_hex(color)) == 7


def test_neighbours_differ_clearly():
    colors = [np.array(identity_color(object_id)) for object_id in range(12)]
    for a, b in itertools.combinations(colors, 2):
        assert np.abs(a - b).max() >= 35


def test_no_identity_is_near_white():
    for object_id in range(500):
        assert min(identity_color(object_id)) <= 128


def test_ink_has_contrast():
    assert ink_on((255, 255, 255)) != (255, 255, 255)
    assert ink_on((10, 10, 60)) == (255, 255, 255)
