import numpy as np
import pytest

from benchmarks.detector_noise import DetectorNoise, worsen
from remind_jax.errors import ConfigError
from remind_jax.frame import Detections

CLASSES = ("mug", "box", "can")


@pytest.fixture
def exact():
    masks = np.zeros((3, 80, 100), bool)
    masks[0, 10:30, 10:30] = masks[1, 10:30, 40:60] = masks[2, 50:75, 20:70] = True
    return Detections.create(masks, ["mug", "mug", "box"], instance_ids=[1, 2, 3])


def test_mistakes_depend_on_seed_and_frame_only(exact):
    noise = DetectorNoise(seed=1, jitter_px=2, missing=0.3, split=0.3, merged=0.3, false=0.5)
    one, two = worsen(exact, noise, CLASSES, 5), worsen(exact, noise, CLASSES, 5)
    np.testing.assert_array_equal(one.masks, two.masks)
    different = [len(worsen(exact, noise, CLASSES, frame)) for frame in range(20)]
    assert len(set(different)) > 1


def test_split_keeps_id_and_pixels(exact):
    halves = worsen(exact, DetectorNoise(split=1.0), CLASSES, 0)
    assert halves.instance_ids.tolist() == [1, 1, 2, 2, 3, 3]
    np.testing.assert_array_equal(halves.masks[0] ^ halves.masks[1], exact.masks[0])


def test_jitter_moves_borders_a_little(exact):
    moved = worsen(exact, DetectorNoise(jitter_px=1.5), CLASSES, 0)
    changed = [(a ^ b).sum() for a, b in zip(moved.masks, exact.masks, strict=True)]
    assert 0 < sum(changed) < exact.masks.sum()


def test_rates_are_checked():
    with pytest.raises(ConfigError, match=r"missing=1\.5 is no probability"):
        DetectorNoise(missing=1.5)
    with pytest.raises(ConfigError, match="every=0"):
        DetectorNoise(every=0)
