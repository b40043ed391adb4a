"""The table of published weights: complete, well formed, and honest about what is not known."""

import math
import re

import pytest

from remind_jax.backbone.published_weights import PUBLISHED
from remind_jax.backbone.vit_variants import VARIANTS
from remind_jax.backbone.vit_weights import leaf_shapes

# Nobody published a hash of these that others confirm.
WITHOUT_HASH = {"dino-vits16", "dino-vits8"}


def test_every_network_that_is_given_out_freely_can_be_named():
    free = {name for name, variant in VARIANTS.items() if variant.family != "dinov3"}
    assert free == {name for name, published in PUBLISHED.items() if not published.is_gated}
    assert set(PUBLISHED) <= set(VARIANTS)


@pytest.mark.parametrize("name", PUBLISHED)
def test_entry_is_well_formed(name):
    published = PUBLISHED[name]
    if published.repository is None:
        assert (published.address or "").startswith("https://dl.fbaipublicfiles.com/dino")
        assert (published.address or "").endswith(f"/{published.file}")
    else:
        assert re.fullmatch(r"facebook/[\w-]+", published.repository)
        assert re.fullmatch(r"[0-9a-f]{40}", published.revision or "")
        assert published.address is None
    if name in WITHOUT_HASH:
        assert published.sha256 is None
    else:
        assert re.fullmatch(r"[0-9a-f]{64}", published.sha256 or "")


def test_no_two_are_the_same_file():
    hashes = [published.sha256 for published in PUBLISHED.values() if published.sha256]
    assert len(set(hashes)) == len(hashes)


@pytest.mark.parametrize("name", [n for n, p in PUBLISHED.items() if p.num_bytes])
def test_size_is_that_of_the_network(name):
    """Numbers of 4 bytes and a little around them; what only training needs is a token at most."""
    expected = 4 * sum(math.prod(shape) for shape in leaf_shapes(VARIANTS[name]).values())
    assert PUBLISHED[name].num_bytes == pytest.approx(expected, rel=0.003)
