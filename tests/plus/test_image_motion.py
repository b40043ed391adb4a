"""Image motion of pictures that were moved on purpose."""

import cv2
import numpy as np
import pytest

from remind_jax.plus.image_motion import observe_motion


def picture(height: int = 240, width: int = 320, seed: int = 0) -> np.ndarray:
    """Blobs of many sizes."""
    rng = np.random.default_rng(seed)
    noise = [
        cv2.resize(rng.uniform(0, 255, (height // k, width // k, 3)), (width, height))
        for k in (4, 10, 25)
    ]
    return np.mean(noise, axis=0).clip(0, 255).astype(np.uint8)


def moved(image: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return cv2.warpAffine(image, matrix, image.shape[1::-1], borderMode=cv2.BORDER_REFLECT)


@pytest.mark.parametrize("size", [(240, 320), (480, 640), (700, 900)])
@pytest.mark.parametrize("shift", [(0, 0), (9, -4), (-40, 12)])
def test_shift_turn_and_zoom_are_found_at_any_size(size, shift):
    image = picture(*size)
    center = (size[1] / 2, size[0] / 2)
    matrix = cv2.getRotationMatrix2D(center, 2.0, 1.02)
    matrix[:, 2] += shift
    motion = observe_motion(image, moved(image, matrix))
    corners = np.array([[50, 50, 1], [size[1] - 50, 60, 1], [80, size[0] - 40, 1]], float).T
    # Half a pixel of the reduced image, which is up to 2.9 pixels of the frame wide.
    np.testing.assert_allclose(motion.matrix @ corners, matrix @ corners, atol=1.5)
    assert motion.score > 0.5
    assert tuple(motion.frame_size) == size


@pytest.mark.parametrize("exposure", [0.4, 0.6, 1.8])
def test_motion_is_found_while_the_light_changes(exposure):
    image = picture()
    matrix = np.array([[1.0, 0.0, 6.0], [0.0, 1.0, -4.0]])
    other = 255 * (moved(image, matrix) / 255.0) ** 1.4 * exposure
    motion = observe_motion(image, other.clip(0, 255).astype(np.uint8))
    np.testing.assert_allclose(motion.matrix, matrix, atol=0.5)  # half a pixel of the image
    assert motion.score > 0.5


def test_a_cut_has_no_motion():
    assert observe_motion(picture(seed=1), picture(seed=2)).score < 0.1


@pytest.mark.parametrize("previous", [None, picture(120, 160)])
def test_without_a_comparable_image_nothing_is_known(previous):
    motion = observe_motion(previous, picture())
    assert motion.score == 0
    np.testing.assert_array_equal(motion.matrix, np.eye(2, 3))


def test_types_never_change():
    motions = [observe_motion(None, None), observe_motion(picture(), picture())]
    flat = np.zeros((240, 320, 3), np.uint8)
    motions.append(observe_motion(flat, flat))
    kinds = {tuple((np.shape(v), np.asarray(v).dtype) for v in vars(m).values()) for m in motions}
    assert len(kinds) == 1
