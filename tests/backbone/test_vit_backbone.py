"""Transformers behind the registry: options, batches, preprocessing, memory."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.backbone import get_backbone
from remind_jax.backbone.vit import Numerics, VisionTransformer, encode
from remind_jax.backbone.vit_backbone import choose_attention, normalize
from remind_jax.backbone.vit_variants import get_variant
from remind_jax.backbone.vit_weights import load_weights
from remind_jax.errors import ConfigError, WeightsError
from tests.backbone.networks import converted, converted_file
from tests.golden.vit import load as golden
from tests.weights_convert.pth_files import write_pth
from weights_convert.conversion import convert
from weights_convert.variant_detection import Wishes

IMAGES = np.random.default_rng(0).integers(0, 256, (2, 64, 96, 3), np.uint8)
MIB = 2**20


@pytest.fixture(scope="module")
def backbone():
    return get_backbone(f"vit:{converted_file('dinov3_tiny_mlp')}")


def test_features_are_those_of_the_network(backbone):
    weights = converted("dinov3_tiny_mlp")
    expected = encode(weights.params, normalize(IMAGES), weights.variant)
    features = backbone.extract(IMAGES)
    assert features.shape == (2, 4, 6, 64)
    assert features.dtype == jnp.float32
    np.testing.assert_allclose(features, expected.patches, rtol=0, atol=3e-5)  # other fusions
    np.testing.assert_allclose(backbone.extract(IMAGES[1:])[0], features[1], rtol=0, atol=3e-5)


def test_preprocessing_is_the_published_one():
    """Rescaled by 1/255, less the mean, over the deviation, for every gray level."""
    levels = np.arange(256, dtype=np.uint8)[:, None].repeat(3, axis=1)
    mean, std = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    published = (levels.astype(np.float64) / 255 - mean) / std
    assert np.abs(jax.jit(normalize)(levels) - published).max() < 1e-6


def test_attention_of_objects_comes_with_the_same_features(backbone):
    patches = np.array([[0, 5, 23, -1], [7, -1, -1, -1]], np.int32)
    features, attention = backbone.extract_with_attention(IMAGES, patches)
    np.testing.assert_allclose(features, backbone.extract(IMAGES), rtol=0, atol=3e-5)
    assert attention.row_sums.shape == (2, 4)
    assert attention.block.shape == (2, 4, 4)
    exists = np.arange(4) < np.array([[3], [1]])
    assert (np.asarray(attention.row_sums > 0) == exists).all()
    # A part of what a patch pays to all patches goes to those of objects.
    sums = np.asarray(attention.block.sum(-1))
    assert (sums[exists] < np.asarray(attention.row_sums)[exists]).all()
    assert (np.asarray(attention.row_sums) <= 1).all()


def test_heads_that_do_not_exist(backbone):
    for heads in ((2,), (-1,), ()):
        with pytest.raises(ConfigError, match=r"heads .* from 0 to 1"):
            backbone.extract_with_attention(IMAGES, np.zeros((2, 1), np.int32), heads=heads)


def test_a_backbone_without_attention_says_so():
    with pytest.raises(ConfigError, match="'patch-statistics' has no attention"):
        get_backbone().extract_with_attention(IMAGES, np.zeros((2, 1), np.int32))


def test_bfloat16_has_another_fingerprint_and_other_features(backbone):
    file = converted_file("dinov3_tiny_mlp")
    rounded = get_backbone(f"vit:{file}", precision="bfloat16")
    assert rounded.fingerprint != backbone.fingerprint
    features = rounded.extract(IMAGES)
    assert features.dtype == jnp.float32
    assert 1e-3 < np.abs(features - backbone.extract(IMAGES)).max() < 0.5


def test_what_no_weight_says_is_in_the_fingerprint_of_a_network_without_a_name(tmp_path):
    write_pth(tmp_path / "plain.pth", golden.load("dino_tiny").official())
    made = []
    for heads in (1, 2):
        file = tmp_path / f"{heads}.safetensors"
        convert(tmp_path / "plain.pth", file, wishes=Wishes(heads=heads, custom=True))
        made.append(get_backbone(f"vit:{file}"))
    assert made[0].name == made[1].name
    assert made[0].fingerprint != made[1].fingerprint


def test_wrong_options():
    file = converted_file("dinov3_tiny_mlp")
    with pytest.raises(ConfigError, match="precision is 'float16'; allowed: float32, bfloat16"):
        get_backbone(f"vit:{file}", precision="float16")
    with pytest.raises(ConfigError, match="has no such option; did you mean 'weights'"):
        get_backbone("dinov3-vits16", weight="a")
    with pytest.raises(WeightsError, match="holds 'custom', not 'dinov3-vits16'"):
        get_backbone("dinov3-vits16", weights=file)


def test_a_published_network_by_name_with_its_weights():
    file = converted_file("dinov3_s16")
    by_option = get_backbone("dinov3-vits16", weights=file)
    by_target = get_backbone(f"dinov3-vits16:{file}")
    assert by_option.name == by_target.name == "dinov3-vits16"
    assert by_option.fingerprint == by_target.fingerprint
    # Profiles and memories are found by it.
    assert by_option.fingerprint.startswith(f"{load_weights(file).sha256}-rotary-float32")
    assert (by_option.patch_px, by_option.dim) == (16, 384)


def test_attention_is_chunked_where_scores_leave_the_cache_of_a_cpu():
    small = get_variant("dinov3-vits16")
    assert choose_attention(small, 5 + 14 * 14, "cpu") == "plain"
    assert choose_attention(small, 5 + 45 * 80, "cpu") == "chunked"
    assert choose_attention(small, 5 + 45 * 80, "gpu") == "plain"


def temporary_mib(num_objects: int) -> float:
    """Memory of ViT-S/16 at 1280x720 besides weights, image and results, by the compiler."""
    variant = get_variant("dinov3-vits16")
    numerics = Numerics(attention="chunked")
    network = VisionTransformer(variant, numerics)
    image = jax.ShapeDtypeStruct((1, 720, 1280, 3), jnp.float32)
    params = jax.eval_shape(functools.partial(network.init, jax.random.key(0)), image)
    objects = jax.ShapeDtypeStruct((1, num_objects), jnp.int32) if num_objects else None

    def forward(params, image, objects):
        tokens = encode(params["params"], image, variant, numerics, objects=objects)
        return tokens.patches, tokens.object_attention

    usage = jax.jit(forward).lower(params, image, objects).compile().memory_analysis()
    return (usage.temp_size_in_bytes + usage.output_size_in_bytes) / MIB


@pytest.mark.usefixtures("optimized")
def test_attention_of_every_patch_of_a_large_frame_fits_in_little_memory():
    without = temporary_mib(0)
    assert without < 200
    assert temporary_mib(45 * 80) - without < 200
