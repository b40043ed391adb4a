import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.files.host_array import host_array
from tests.sources.published import DLPackOnly, Tensor

VALUES = np.arange(6, dtype=np.float32).reshape(2, 3)


@pytest.mark.parametrize(
    "given",
    [
        VALUES,
        Tensor(VALUES),
        Tensor(VALUES, requires_grad=True),
        DLPackOnly(VALUES),
        memoryview(VALUES),
    ],
    ids=["numpy", "tensor", "with gradients", "dlpack", "buffer"],
)
def test_arrays_on_the_host_are_not_copied(given):
    found = host_array(given, "masks")
    np.testing.assert_array_equal(found, VALUES)
    assert np.shares_memory(found, VALUES)


@pytest.mark.parametrize("given", [jnp.asarray(VALUES), VALUES.tolist(), list(VALUES)])
def test_other_forms_are_read(given):
    np.testing.assert_array_equal(host_array(given, "masks"), VALUES)


def test_what_makes_no_array_is_refused():
    class Broken:
        def __array__(self, *args, **kwargs):
            raise KeyError("x")

    for given in (
        Tensor(VALUES, "cuda:0"),
        [Tensor(VALUES, "cuda:1")],
        DLPackOnly(VALUES, kind=2),
        [[1, 2], [3]],
        Broken(),
        np.ma.masked_array(np.ones((1, 2, 2)), mask=True),
    ):
        with pytest.raises(SourceError, match=r"^masks"):
            host_array(given, "masks")
    with pytest.raises(SourceError, match=r"^masks make no .* \(some are ndarray and str\)"):
        host_array([VALUES, "a"], "masks")
