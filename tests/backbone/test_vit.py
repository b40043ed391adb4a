"""The transformers against what the official code computes."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.backbone.vit import Numerics, Tokens, VisionTransformer, arrange_params, encode
from remind_jax.backbone.vit_attention import NO_PATCH
from remind_jax.backbone.vit_variants import VARIANTS
from remind_jax.backbone.vit_weights import Weights, leaf_shapes
from tests.backbone.networks import converted
from tests.golden.vit import load as golden

# Outputs have a root mean square of one; PyTorch's float32 is up to 5e-5 from its own float64.
OUTPUTS = 1e-4
# Softmax rows, in which the same rounding appears undiluted.
ATTENTION = 3e-5


def first_only(stems: list[str]) -> list:
    """The others compile as much again."""
    return [pytest.param(one, marks=pytest.mark.slow if n else []) for n, one in enumerate(stems)]


def run(
    weights: Weights, images: np.ndarray, numerics: Numerics | None = None, **options
) -> Tokens:
    run_once = jax.jit(lambda params, x: encode(params, x, weights.variant, numerics, **options))
    return run_once(weights.params, images)


def difference(tokens: Tokens, network: golden.Network, size: str, kind: str = "") -> float:
    """Largest over all recorded patches."""
    patches = np.asarray(tokens.patches).reshape(-1, network.config["width"])
    found = patches[network.arrays[f"{size}/patch_index"]]
    return float(np.abs(found - network.arrays[f"{size}/{kind}patches"]).max())


CASES = [
    pytest.param(stem, size, marks=[] if size == golden.load(stem).sizes[0] else pytest.mark.heavy)
    for stem in (*golden.TINY, "dinov3_s16")
    for size in golden.load(stem).sizes
]


@pytest.mark.parametrize(("stem", "size"), CASES)
def test_outputs_are_those_of_the_official_code(stem, size):
    network, weights = golden.load(stem), converted(stem)
    assert difference(run(weights, network.image(size)), network, size) < OUTPUTS


@pytest.mark.parametrize("stem", first_only([s for s in golden.TINY if s.startswith("dinov3")]))
def test_periods_of_a_file_are_used(stem):
    network, weights = golden.load(stem), converted(stem, rounded_periods=True)
    for size in network.sizes:
        tokens = run(weights, network.image(size))
        assert difference(tokens, network, size, "bf16periods_") < OUTPUTS
        assert difference(tokens, network, size) > 100 * OUTPUTS


@pytest.mark.parametrize(
    "stem", first_only(["dinov2_tiny", "dinov2_tiny_swiglu", "dino_tiny", "dino_tiny_p8"])
)
def test_the_other_rule_of_resampling_is_that_of_hugging_face(stem):
    network, weights = golden.load(stem), converted(stem)
    variant = dataclasses.replace(weights.variant, position="size")
    weights = dataclasses.replace(weights, variant=variant)
    sizes = [size for size in network.sizes if f"{size}/hf_cls" in network.arrays]
    assert sizes
    for size in sizes:
        tokens = run(weights, network.image(size))
        assert difference(tokens, network, size, "hf_") < OUTPUTS
        assert difference(tokens, network, size) > 1000 * OUTPUTS


def test_what_does_not_fill_a_patch_is_left_out():
    network, weights = golden.load("dinov3_tiny_mlp"), converted("dinov3_tiny_mlp")
    image = np.pad(network.image("64x112"), [(0, 0), (0, 15), (0, 9), (0, 0)])
    assert difference(run(weights, image), network, "64x112") < OUTPUTS


@pytest.mark.parametrize(
    "stem", first_only(["dinov3_tiny_mlp", "dinov3_tiny_swiglu", "dinov3_s16"])
)
def test_attention_of_objects_is_the_block_of_the_whole_map(stem):
    network, weights = golden.load(stem), converted(stem)
    size = network.sizes[0]
    whole = network.arrays[f"{size}/attention_mean"]
    chosen = np.array([[3, NO_PATCH, 0, len(whole) - 1, 7, NO_PATCH]])
    tokens = run(weights, network.image(size), objects=chosen)
    assert difference(tokens, network, size) < OUTPUTS
    among = tokens.object_attention
    slots, patches = np.array([0, 2, 3, 4]), chosen[0, [0, 2, 3, 4]]
    block = np.asarray(among.block[0])
    assert np.abs(block[np.ix_(slots, slots)] - whole[np.ix_(patches, patches)]).max() < ATTENTION
    assert np.abs(among.row_sums[0, slots] - whole.sum(1)[patches]).max() < ATTENTION
    assert not block[[1, 5]].any()
    assert not block[:, [1, 5]].any()
    assert not np.asarray(among.row_sums)[0, [1, 5]].any()


@pytest.mark.parametrize("stem", first_only(["dinov3_tiny_mlp", "dino_tiny", "dinov2_tiny_swiglu"]))
def test_bfloat16_rounds_little(stem):
    """With weights far sharper than trained ones; each token points where it did."""
    network, weights = golden.load(stem), converted(stem)
    image = network.image(network.sizes[0])
    exact, rounded = (
        np.asarray(run(weights, image, Numerics(dtype)).patches, np.float64)
        for dtype in (jnp.float32, jnp.bfloat16)
    )
    lengths = np.linalg.norm(exact, axis=-1) * np.linalg.norm(rounded, axis=-1)
    assert ((exact * rounded).sum(-1) / lengths).min() > 0.9995
    assert np.abs(exact - rounded).max() > 1e-3


def test_weights_arranged_beforehand_change_nothing():
    network, weights = golden.load("dinov3_tiny_swiglu"), converted("dinov3_tiny_swiglu")
    image, numerics = network.image(network.sizes[0]), Numerics(jnp.bfloat16)
    arranged = arrange_params(weights.params, weights.variant, numerics)
    assert arranged["early_blocks"]["attention"]["qkv"]["kernel"].dtype == jnp.float32
    assert arranged["blocks"]["attention"]["qkv"]["kernel"].dtype == jnp.bfloat16
    assert arranged["blocks"]["norm1"]["scale"].dtype == jnp.float32
    twice = arrange_params(arranged, weights.variant, numerics)
    assert jax.tree.all(jax.tree.map(lambda a, b: a is b, arranged, twice))
    beforehand = run(dataclasses.replace(weights, params=arranged), image, numerics)
    np.testing.assert_array_equal(beforehand.patches, run(weights, image, numerics).patches)


def test_float32_products_are_full_or_of_tensor_cores():
    """On a CPU no result tells them apart."""
    assert Numerics().precision == jax.lax.Precision.HIGHEST
    assert Numerics(jnp.bfloat16).for_early().precision == jax.lax.Precision.HIGH


@pytest.mark.parametrize("name", VARIANTS)
def test_files_hold_what_the_network_asks_for(name):
    """The list of leaves and the modules are written apart; they must agree for every variant."""
    variant = VARIANTS[name]
    side = 2 * variant.patch_px
    network = VisionTransformer(variant)
    image = jax.ShapeDtypeStruct((1, side, side, 3), jnp.float32)
    asked = jax.eval_shape(functools.partial(network.init, jax.random.key(0)), image)["params"]
    given: dict[str, tuple[int, ...]] = {}
    for leaf, shape in leaf_shapes(variant).items():
        head, _, rest = leaf.partition(".")
        if head == "blocks":
            given["blocks." + rest.partition(".")[2]] = (variant.depth, *shape)
        else:
            given[leaf] = shape
    found = {
        jax.tree_util.keystr(path, simple=True, separator="."): leaf.shape
        for path, leaf in jax.tree_util.tree_flatten_with_path(asked)[0]
    }
    assert found == given
