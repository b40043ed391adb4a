import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.printing.words import compare, listing, number, sentence, threshold


@given(st.floats(0, 2), st.sampled_from([0.0001, 0.02, 0.05, 0.1, 0.75, 0.9]))
def test_a_comparison_reads_as_it_is(value, limit):
    sign = ">=" if value >= limit else "<"
    left, _, right = compare(value, sign, limit).split()
    assert float(right) == limit
    if abs(value - limit) > 1e-8:  # nine decimals are shown at most
        assert (float(left) >= limit) == (value >= limit)


def test_numbers_and_sentences():
    assert compare(0.7499, "<", 0.75) == "0.7499 < 0.75"
    assert compare(0.71, ">=", 0.65) == "0.71 >= 0.65"
    assert (number(0.004), number(0.0), number(-0.5)) == ("0.004", "0.00", "-0.50")
    assert (threshold(0.1), threshold(0.75), threshold(1e-4)) == ("0.10", "0.75", "0.0001")
    assert sentence("mug 3 is near") == "Mug 3 is near."


@pytest.mark.parametrize(
    ("items", "text"), [([], ""), (["a"], "a"), (["a", "b"], "a and b"), ("abc", "a, b and c")]
)
def test_lists(items, text):
    assert listing(list(items)) == text
