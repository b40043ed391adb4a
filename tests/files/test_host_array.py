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


@pytest.mark.parametrize(
    ("given", "place"),
    [
        (Tensor(VALUES, "cuda:0"), "cuda:0"),
        ([Tensor(VALUES, "cuda:1")], "cuda:1"),
        (DLPackOnly(VALUES, kind=2), "cuda"),
        (DLPackOnly(VALUES, kind=99), "kind 99"),
    ],
)
def test_arrays_elsewhere_are_refused_with_what_to_do(given, place):
    with pytest.raises(SourceError, match=rf"masks lie in .*'{place}'.*\.cpu\(\)$"):
        host_array(given, "masks")


def test_a_masked_array_is_refused():
    with pytest.raises(SourceError, match=r"masks are a masked array, .* fill them, by \.filled"):
        host_array(np.ma.masked_array(np.ones((1, 2, 2)), mask=True), "masks")


def test_ragged_values_make_no_array():
    with pytest.raises(SourceError, match=r"^boxes make no array: .*; give one array of numbers$"):
        host_array([[1, 2], [3]], "boxes")


@pytest.mark.parametrize("error", [KeyError("x"), RecursionError(), ZeroDivisionError("no")])
def test_what_breaks_in_code_of_others_is_told(error):
    class Broken:
        def __array__(self, *args, **kwargs):
            raise error

    with pytest.raises(SourceError, match=r"^masks make no array: .*; give one array of numbers$"):
        host_array(Broken(), "masks")
