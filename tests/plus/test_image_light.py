"""Light that changes on whole images, and what is made of it."""

import cv2
import numpy as np
import pytest

from remind_jax.plus.image_light import SENSOR_OFFSET, ImageLight, find_change
from remind_jax.plus.image_motion import observe_motion


def picture(seed: int = 0) -> np.ndarray:
    """Blobs of many colors and sizes."""
    rng = np.random.default_rng(seed)
    noise = [cv2.resize(rng.uniform(40, 170, (240 // k, 320 // k, 3)), (320, 240)) for k in (5, 20)]
    return np.mean(noise, axis=0).astype(np.uint8)


def in_light(image: np.ndarray, gains: tuple[float, ...], contrast: float = 1.0) -> np.ndarray:
    level = 100.0 + SENSOR_OFFSET
    colors = level * ((image + SENSOR_OFFSET) / level) ** contrast * np.array(gains)
    return np.clip(np.round(colors - SENSOR_OFFSET), 0, 255).astype(np.uint8)


def show(images: list[np.ndarray]) -> list[np.ndarray]:
    """The images of a stream in steady light."""
    light, last, shown = ImageLight(), None, []
    for image in images:
        light.follow(image, observe_motion(last, image))
        last = image
        shown.append(light.steady(image))
    return shown


def tint_error(image: np.ndarray, other: np.ndarray) -> float:
    """Median difference of logarithms of color ratios."""
    tints = [np.log(one[..., [0, 2]] + 4.0) - np.log(one[..., [1]] + 4.0) for one in (image, other)]
    return float(np.median(np.abs(tints[0] - tints[1])))


@pytest.mark.parametrize("gains", [(1.2, 1.0, 0.8), (0.6, 0.7, 0.6), (0.7, 0.9, 1.1)])
@pytest.mark.parametrize("contrast", [1.0, 0.8, 1.2])
def test_another_light_is_undone_while_the_camera_moves(gains, contrast):
    image = picture()
    moved = np.roll(image, (3, 5), (0, 1))
    changed = in_light(moved, gains, contrast)
    assert tint_error(changed, moved) > 0.07
    # Gray levels are whole numbers: that is 0.01 of the darker ones.
    assert tint_error(show([image, changed])[1], moved) < 0.02


def test_light_that_changes_slowly_is_undone_while_the_camera_moves():
    image, evening = picture(), np.array((0.8, 1.0, 1.25))
    moved = [np.roll(image, (t, 2 * t), (0, 1)) for t in range(61)]
    changed = [in_light(one, tuple(evening ** (t / 60))) for t, one in enumerate(moved)]
    shown = show(changed)
    assert tint_error(changed[-1], moved[-1]) > 0.2
    # What was not enough to be undone yet, and what changed since the last comparison.
    assert tint_error(shown[-1], moved[-1]) < 0.08


def test_noise_adds_up_to_no_light():
    rng, image = np.random.default_rng(0), picture().astype(float)
    noise = rng.normal(0, 8, (150, 1, 1, 3)) * 0.1 + rng.normal(0, 8, (150, *image.shape))
    noisy = np.clip(image + noise, 0, 255).astype(np.uint8)
    images = [np.roll(one, (t, 3 * t), (0, 1)) for t, one in enumerate(noisy)]
    for given, shown in zip(images, show(images), strict=True):
        assert shown is given


def test_images_stay_as_they_are_where_light_does():
    images = [picture(), in_light(picture(), (0.7, 0.7, 0.7))]
    for image, shown in zip(images, show(images), strict=True):
        assert shown is image


def test_a_wall_in_the_place_of_another_is_no_light():
    before = cv2.resize(picture(), (96, 72))
    now = before.copy()
    # Two rooms seen through a door: most pixels agree that all became bluer.
    before[:, 30:], now[:, 30:] = (150, 130, 125), (125, 130, 150)
    assert find_change(before, now) is None


def test_light_that_is_back_leaves_images_as_they_are():
    image, other = picture(), in_light(picture(), (1.2, 1.0, 0.8))
    last = show([image, other] * 20 + [image])[-1]
    np.testing.assert_array_equal(last, image)


def test_what_was_found_stays_over_a_cut():
    first, other = picture(), in_light(picture(), (1.2, 1.0, 0.8))
    elsewhere = in_light(picture(seed=1), (1.2, 1.0, 0.8))
    shown = show([first, other, elsewhere])[-1]
    assert tint_error(shown, picture(seed=1)) < 0.02


def test_a_large_thing_of_another_color_is_no_light():
    image = picture()
    covered = image.copy()
    covered[:, :150] = in_light(image[:, :150], (1.3, 1.0, 0.7))
    assert find_change(image, covered) is None
    assert find_change(image, in_light(image, (1.3, 1.0, 0.7))) is not None


@pytest.mark.parametrize("level", [0, 255])
def test_black_and_white_images_tell_nothing(level):
    flat = np.full((120, 160, 3), level, np.uint8)
    assert find_change(picture()[:120, :160], flat) is None


def test_behind_a_frame_without_an_image_no_change_is_told():
    image, other = picture(), in_light(picture(), (1.2, 1.0, 0.8))
    for between, is_told in (([], True), ([None], False)):
        light = ImageLight()
        for shown in (image, *between, other):
            light.follow(shown, observe_motion(image, other))
        assert (light.steady(other) is not other) == is_told
