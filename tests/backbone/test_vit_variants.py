import dataclasses

import pytest

from remind_jax.backbone.vit_variants import CUSTOM, TERMS, VARIANTS, get_variant, name_of
from remind_jax.errors import ConfigError


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_is_sound_and_found_by_its_architecture(name):
    variant = VARIANTS[name]
    variant.check()
    assert get_variant(name) is variant
    assert name_of(dataclasses.replace(variant, name="any")) == name
    assert variant.family in TERMS
    assert variant.head_width * variant.heads == variant.width
    assert (variant.position == "rotary") == (variant.table_side == 0)


def test_how_a_table_is_resampled_does_not_make_another_network():
    variant = dataclasses.replace(VARIANTS["dinov2-vits14"], position="size")
    assert name_of(variant) == "dinov2-vits14"


def test_a_changed_architecture_has_no_published_name():
    assert name_of(dataclasses.replace(VARIANTS["dino-vits16"], depth=11)) == CUSTOM


@pytest.mark.parametrize(
    ("change", "why"),
    [({"heads": 5}, "cannot be split among 5"), ({"heads": 64}, "cannot be rotated by two axes")],
)
def test_numbers_that_contradict_each_other(change, why):
    with pytest.raises(ConfigError, match=why):
        dataclasses.replace(VARIANTS["dinov3-vits16"], **change).check()
