import jax
import numpy as np
import pytest

from remind_jax.remind.context.evidence import ROUNDED_OBJECTS, join_links, maturity
from tests.statics import make_static

from .scenes import STATIC, example, list_scenes, read_view, thresholds, view_of

pytestmark = pytest.mark.usefixtures("x64")
_join = jax.jit(join_links, static_argnames="static")


def join(view, num_in_question=10, static=STATIC, **changed):
    rules = thresholds(sets=changed).sets
    return jax.device_get(_join(view, np.int32(num_in_question), static=static, t=rules))


def test_maturity_of_the_page():
    """method.md#maturity; rounded to six places."""
    trust = maturity(np.arange(7), thresholds().sets)
    expected = [0, 0.221199, 0.393469, 0.527633, 0.632121, 0.713495, 0.776870]
    np.testing.assert_allclose(trust, expected, atol=1e-6)


def test_conditional_of_the_page():
    """method.md#example-company: six and four episodes, five objects; an unseen pair counts."""
    view = read_view(example(), thresholds(), STATIC)
    rows = np.asarray(view.conditional)
    np.testing.assert_allclose(rows[0, :5], np.array([0.5, 6.5, 0.5, 6.5, 0.5]) / 8.5, rtol=1e-15)
    np.testing.assert_allclose(rows[2, :5], np.array([0.5, 0.5, 0.5, 0.5, 4.5]) / 6.5, rtol=1e-15)


def test_links_of_a_memory_are_symmetric_and_none_to_oneself():
    for scene in list_scenes()[:5]:
        links = join(read_view(scene, thresholds(), STATIC))
        np.testing.assert_array_equal(links.strength, links.strength.T)
        np.testing.assert_array_equal(links.present, links.present.T)
        assert not np.any(np.diag(links.strength))
        assert not np.any(np.diag(links.present))
        assert np.all(links.strength[links.present] > 0)


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


def test_pairs_never_seen_together_have_strength_but_are_not_linked():
    links = join(view_of(np.full((2, 2), 0.25)))
    assert links.strength[0, 1] == 0.25
    assert not np.any(links.present)


@pytest.mark.parametrize(("num", "rounded"), [(ROUNDED_OBJECTS, True), (161, False)])
def test_strengths_of_few_objects_have_single_precision(num, rounded):
    links = join(view_of(np.full((2, 2), 0.3)), num)
    assert links.strength[0, 1] == (np.float32(0.3) if rounded else np.sqrt(0.3 * 0.3))
