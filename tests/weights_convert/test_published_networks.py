"""Files of every published network, of full size but without numbers: shapes and keys only."""

import numpy as np
import pytest

from remind_jax.backbone.vit_variants import VARIANTS, Variant
from remind_jax.backbone.vit_weights import leaf_shapes
from tests.golden.vit.weights import official_shapes
from tests.weights_convert.hugging_face import as_hugging_face
from weights_convert.key_layouts import name_tensors
from weights_convert.leaf_recipes import check_complete, recipes
from weights_convert.stored_tensors import StoredTensor
from weights_convert.variant_detection import Wishes, detect_variant


def official(variant: Variant) -> dict[str, np.ndarray]:
    """One number per tensor, seen through its shape."""
    v = variant
    split = "swiglu_split" if v.family == "dinov3" else "swiglu_fused"
    shapes = official_shapes(
        v.family,
        v.width,
        v.depth,
        v.heads,
        v.patch_px,
        mlp=split if v.mlp == "swiglu" else "mlp",
        hidden=v.hidden,
        registers=v.registers,
        grid=v.table_side,
        qkv_bias=v.qkv_bias != "none",
        local_cls_norm=v.name in ("dinov3-vitl16", "dinov3-vit7b16"),
    )
    return {key: np.broadcast_to(np.float32(0), shape) for key, shape in shapes.items()}


@pytest.mark.parametrize("layout", ["official", "hugging face"])
@pytest.mark.parametrize("name", VARIANTS)
def test_is_recognised_and_every_key_has_its_place(name, layout):
    tensors = official(VARIANTS[name])
    if layout == "hugging face":
        tensors = as_hugging_face(tensors, VARIANTS[name].family, copied=False)
    stored = {k: StoredTensor(t.shape, lambda t=t: t) for k, t in tensors.items()}
    named = name_tensors(stored, "file")
    wishes = Wishes(variant=name if VARIANTS[name].family == "dino" else None)
    variant = detect_variant(named, {}, wishes, "file")
    assert variant.name == name
    wanted = recipes(variant, named.tensors)
    check_complete(wanted, named.tensors, named.source_keys, named.unexpected, "file", variant.name)
    assert [recipe.leaf for recipe in wanted] == list(leaf_shapes(VARIANTS[name]))
