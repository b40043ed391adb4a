import jax
import numpy as np
import pytest

from remind_jax.remind.context.evidence import ROUNDED_OBJECTS, join_links
from tests.statics import make_static

from .scenes import STATIC, thresholds, view_of

pytestmark = pytest.mark.usefixtures("x64")
_join = jax.jit(join_links, static_argnames="static")


def join(view, num_in_question=10, static=STATIC, **changed):
    rules = thresholds(sets=changed).sets
    return jax.device_get(_join(view, np.int32(num_in_question), static=static, t=rules))


@pytest.mark.parametrize(("mutual", "joint"), [(True, 0.1), (False, 0.5 * (0.02 + 0.5))])
def test_both_accounts_are_joined(mutual, joint):
    conditional = np.array([[0.9, 0.02], [0.5, 0.9]])
    count = np.array([[0, 0], [3, 0]], np.int32)  # the first object has forgotten the edge
    view = view_of(conditional, count=count)
    links = join(view, static=make_static(precision="float64", mutual_links=mutual))
    expected = np.array([[0, joint], [joint, 0]])
    np.testing.assert_array_equal(links.strength, expected.astype(np.float32))
    np.testing.assert_array_equal(links.present, expected > 0)


def test_weak_ties_are_none():
    """A tie as strong as the threshold counts, one just below does not (method.md#member-sets)."""
    conditional = np.full((3, 3), 0.0625)
    conditional[0, 1] = conditional[1, 0] = np.nextafter(0.0625, 0)
    view = view_of(conditional, count=np.full((3, 3), 2, np.int32))
    links = join(view, min_link=0.0625)
    linked = np.array([[0, 0, 1], [0, 0, 1], [1, 1, 0]], bool)
    np.testing.assert_array_equal(links.present, linked)
    np.testing.assert_array_equal(links.strength, 0.0625 * linked)


@pytest.mark.parametrize(("num", "rounded"), [(ROUNDED_OBJECTS, True), (161, False)])
def test_strengths_of_few_objects_have_single_precision(num, rounded):
    links = join(view_of(np.full((2, 2), 0.3)), num)
    assert links.strength[0, 1] == (np.float32(0.3) if rounded else np.sqrt(0.3 * 0.3))
