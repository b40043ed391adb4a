"""From what a user says to a backbone."""

import numpy as np
import pytest

from remind_jax.backbone import get_backbone
from remind_jax.backbone.opening import open_backbone
from remind_jax.errors import ConfigError
from tests.backbone.networks import converted_file

IMAGES = np.zeros((1, 32, 32, 3), np.uint8)


def test_name_with_weights_and_cache(tmp_path):
    file = converted_file("dinov3_s16")
    backbone = open_backbone("dinov3-vits16", weights=file, feature_cache=tmp_path)
    expected = get_backbone("dinov3-vits16", weights=file).extract(IMAGES)
    for _ in range(2):
        np.testing.assert_array_equal(backbone.extract(IMAGES), expected)
    assert backbone.name == "dinov3-vits16"
    assert len(list(tmp_path.rglob("*.npy"))) == 1


def test_finished_backbone():
    backbone = get_backbone()
    assert open_backbone(backbone) is backbone
    with pytest.raises(ConfigError, match="beside the finished backbone 'patch-statistics'"):
        open_backbone(backbone, weights="a.safetensors")
