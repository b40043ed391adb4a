"""Settings become arrays of the kinds that compiled programs take."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from remind_jax.settings.arrays import AsArrays
from remind_jax.settings.kinds import Gate, Real, Whole


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Sample(AsArrays):
    share: Real = 0.5
    count: Whole = 3
    is_on: Gate = True


@pytest.mark.parametrize("scalar", [jnp.float32, jnp.float16])
def test_kinds(scalar):
    arrays = Sample().as_arrays(scalar)
    assert (arrays.share.dtype, arrays.count.dtype, arrays.is_on.dtype) == (scalar, "int32", "bool")
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(arrays))
    # Sweeps keep their axis.
    assert Sample(share=jnp.linspace(0, 1, 4)).as_arrays().share.shape == (4,)
