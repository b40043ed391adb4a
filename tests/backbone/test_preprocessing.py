import numpy as np

from remind_jax.backbone.preprocessing import MEAN, STD, normalize


def test_the_mean_color_becomes_zero_and_black_its_negative():
    images = np.stack([np.rint(255 * MEAN), np.zeros(3)]).astype(np.uint8)
    found = np.asarray(normalize(images))
    assert found.dtype == np.float32
    # Half a step of 1/255, in standard deviations.
    assert np.abs(found[0]).max() <= 0.5 / 255 / STD.min()
    np.testing.assert_allclose(found[1], -MEAN / STD, rtol=1e-6)
