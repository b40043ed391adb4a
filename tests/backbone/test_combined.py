"""Several backbones as one: same patches, no part outweighs another."""

import cv2
import numpy as np
import pytest

from remind_jax.backbone import Backbone, get_backbone
from remind_jax.backbone.combined import combine
from remind_jax.backbone.opening import open_backbone
from remind_jax.backbone.registry import check_name, parts_of, register
from remind_jax.errors import ConfigError
from tests.backbone.networks import converted_file

RNG = np.random.default_rng(0)
IMAGES = RNG.integers(0, 256, (2, 64, 96, 3), np.uint8)


def cosines(features) -> np.ndarray:
    flat = np.asarray(features, np.float64).reshape(-1, features.shape[-1])
    flat = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    return flat @ flat.T


@pytest.fixture(scope="module")
def vit() -> str:
    return f"vit:{converted_file('dinov3_tiny_mlp')}"


def test_the_cosine_is_the_mean_of_the_parts_cosines(vit):
    both, first, second = (
        get_backbone(n) for n in (f"patch-statistics+{vit}", "patch-statistics", vit)
    )
    assert (both.patch_px, both.dim) == (16, first.dim + second.dim)
    expected = (cosines(first.extract(IMAGES)) + cosines(second.extract(IMAGES))) / 2
    np.testing.assert_allclose(cosines(both.extract(IMAGES)), expected, rtol=0, atol=1e-5)


def test_patches_of_another_size_are_the_same_pieces_of_the_scene():
    """A network of 14 pixels beside one of 16: a bright piece is where it is in the frame."""
    other = f"vit:{converted_file('dinov2_tiny')}"
    both, alone = get_backbone(f"patch-statistics+{other}"), get_backbone(other)
    found = np.asarray(both.extract(IMAGES))
    assert found.shape == (2, 4, 6, both.dim)
    scaled = np.stack([cv2.resize(i, (84, 56), interpolation=cv2.INTER_AREA) for i in IMAGES])
    expected = np.asarray(alone.extract(scaled))
    expected = expected / np.linalg.norm(expected, axis=-1, keepdims=True)
    got = found[..., -alone.dim :] * 2**0.5
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-5)


def test_fingerprint_is_of_all_parts_and_their_order(vit):
    names = (f"patch-statistics+{vit}", f"{vit}+patch-statistics", "patch-statistics", vit)
    made = [get_backbone(name) for name in names]
    assert len({backbone.fingerprint for backbone in made}) == 4
    assert made[0].name == f"patch-statistics+{made[3].name}"


def test_a_part_that_gives_no_grid_is_named():
    part = Backbone("flat", 16, 3, lambda images: np.zeros((len(images), 3), np.float32))
    joined = combine([get_backbone("patch-statistics"), part])
    with pytest.raises(ConfigError, match="'flat'"):
        joined.extract(IMAGES)


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("patch-statistics", ["patch-statistics"]),
        ("patch-statistics+onnx:a.onnx", ["patch-statistics", "onnx:a.onnx"]),
        ("onnx:a+b.onnx", ["onnx:a+b.onnx"]),
        ("onnx:a+b.onnx+vit:c+d+onnx:e", ["onnx:a+b.onnx", "vit:c+d", "onnx:e"]),
        ("dino-vits8+dinov2-vits14", ["dino-vits8", "dinov2-vits14"]),
        ("patch-statistics+nonsense", ["patch-statistics", "nonsense"]),
    ],
)
def test_pluses_join_names_and_may_be_part_of_files(name, parts):
    assert parts_of(name) == parts


def test_what_cannot_be_joined():
    with pytest.raises(ConfigError, match="there is no backbone 'nonsense'"):
        check_name("patch-statistics+nonsense")
    with pytest.raises(ConfigError, match=r"takes no option \(weights\).*'vit:FILE'"):
        open_backbone("patch-statistics+dinov2-vits14", weights="a.safetensors")
    with pytest.raises(ConfigError, match="without a plus"):
        register("a+b", lambda: None)
