"""An estimated image motion is believed only where detections agree with it."""

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.plus import motion_check
from tests.plus.frames import T, detections, motion, tracklets_of

PLACES = np.array([[1.0, 1.0], [3.0, 1.5], [1.5, 3.5]])
SAME = jnp.eye(3)
check_motion, imply_motion = jax.jit(motion_check.check_motion), jax.jit(motion_check.imply_motion)


def believed(shift, estimate):
    """The shift that is believed where all detections moved by `shift`."""
    tracklets = tracklets_of(detections(PLACES), 0, 3)
    seen = detections(PLACES + np.asarray(shift))
    found, _ = check_motion(estimate, tracklets, seen, SAME, SAME, T)
    return np.asarray(found.matrix[:, 2]), float(found.score)


def test_an_estimate_that_fits_is_kept():
    shift, score = believed((0.8, 0.0), motion((0.8, 0.0), 0.9))
    np.testing.assert_allclose(shift, [0.8, 0.0], atol=1e-6)
    assert score == np.float32(0.9)


def test_a_wrong_estimate_gives_way_to_what_detections_agree_on():
    shift, score = believed((0.0, 0.0), motion((3.0, 0.0), 0.9))
    np.testing.assert_allclose(shift, [0.0, 0.0], atol=1e-6)
    shift, score = believed((2.0, 0.5), motion((-2.0, 0.0), 0.9))
    np.testing.assert_allclose(shift, [2.0, 0.5], atol=1e-6)
    assert score == np.float32(motion_check.IMPLIED_SCORE)


def test_too_few_that_agree_imply_nothing():
    tracklets = tracklets_of(detections(PLACES), 0, 3)
    apart = detections(PLACES + np.array([[1.0, 0], [-1.0, 0], [0, 2.0]]))
    implied = imply_motion(tracklets, apart, SAME)
    assert implied["score"] == 0
    np.testing.assert_allclose(implied["matrix"], np.eye(2, 3))
