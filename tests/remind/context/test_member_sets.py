"""Sets that grow member by member, against trees and means over all members at once."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.context.evidence import Links
from remind_jax.remind.context.member_sets import (
    LinkCounts,
    empty_set,
    extend_paths,
    extend_tree,
    line_up,
    link_strengths,
    rate_cohesion,
    reach_members,
    tree_edges,
)

from .scenes import thresholds

pytestmark = pytest.mark.usefixtures("x64")
OBJECTS = 6
ROUNDING = 1e-12  # float64, a handful of operations on numbers below 1
quick = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def weigh_plainly(strength):
    """Weight of the maximum spanning tree of a complete graph of strengths in [0, 1]."""
    # The solver takes 0 for no edge and minimizes: turn strengths around, above 0.
    tree = minimum_spanning_tree(2.0 - strength).toarray()
    return float(np.sum(2.0 - tree[tree > 0]))


@jax.jit
def _weigh_in_order(strength, order):
    """Tree of the objects that enter one after the other; NO_SLOT ends the list."""
    blank = jnp.zeros_like(strength, bool)
    links = Links(maturity=strength[0], strength=strength, present=blank)
    start = empty_set(OBJECTS, OBJECTS, strength.dtype)
    slot = line_up(start, order)
    path, edges = start.path, tree_edges(start.path)
    for entry, link in enumerate(link_strengths(order, slot, links)):
        reach = reach_members(path, link)
        edges = extend_tree(edges, reach)
        path = extend_paths(path, reach, jnp.where(order[entry] == NO_SLOT, NO_SLOT, entry))
    return slot, jnp.stack([jnp.sum(tree_edges(path)), jnp.sum(edges)])


@quick
@given(
    st.lists(st.sampled_from([0.0, 0.25, 0.5, 0.8, 1.0]), min_size=15, max_size=15),
    st.permutations(range(OBJECTS)),
    st.integers(0, OBJECTS),
)
def test_paths_yield_the_maximum_spanning_tree(strengths, order, count):
    strength = np.zeros((OBJECTS, OBJECTS))
    strength[np.triu_indices(OBJECTS, 1)] = strengths
    strength += strength.T
    newcomers = np.where(np.arange(OBJECTS) < count, order, NO_SLOT).astype(np.int32)
    slot, weight = jax.device_get(_weigh_in_order(strength, newcomers))
    np.testing.assert_array_equal(slot, newcomers)
    members = np.array(order[:count], int)
    plain = weigh_plainly(strength[np.ix_(members, members)]) if count > 1 else 0.0
    np.testing.assert_allclose(weight, plain, rtol=0, atol=ROUNDING)


def test_newcomers_line_up_behind_the_members():
    one = dataclasses.replace(
        empty_set(4, 9, jnp.dtype("float64")),
        slot=jnp.array([7, 2, NO_SLOT, NO_SLOT]),
        size=jnp.int32(2),
    )
    np.testing.assert_array_equal(line_up(one, jnp.array([5, NO_SLOT])), [7, 2, 5, NO_SLOT])
    np.testing.assert_array_equal(line_up(one, jnp.array([5, 8, 1])), [7, 2, 5, 8])


def cohesion(size, tree, pairs, linked, isolated, **changed):
    counts = LinkCounts(np.float64(pairs), np.float64(linked), np.bool_(isolated))
    rated = rate_cohesion(np.int32(size), np.float64(tree), counts, thresholds(sets=changed).sets)
    return float(rated.density), float(rated.connection)


@pytest.mark.parametrize(
    ("given_", "changed", "density", "connection"),
    [
        ((0, 0.0, 0, 0, False), {}, 0, 1),
        ((1, 0.0, 0, 0, True), {}, 0, 1),
        # 19.3: three objects always seen together, 6.5 / 8.5 each
        ((3, 2 * 6.5 / 8.5, 3, 3, False), {}, 6.5 / 8.5, 1),
        # two of three pairs linked: half the paths, less for the pairs
        ((3, 1.0, 2, 3, False), {}, 0.5 * 2 / 3, 2 / 3),
        ((3, 1.0, 1, 2, True), {}, 0.5 / 3, 0),
        # nobody needs a link: shares of members and pairs decide
        ((3, 1.0, 1, 2, False), {"min_links": 0}, 0.5 / 3, (2 / 3) ** 1.5 / 3),
        # powers that are not positive leave a share out
        ((3, 1.0, 1, 2, False), {"density_power": 0.0, "pairs_power": -1.0}, 0.5, (2 / 3) ** 1.5),
        # without a least strength all pairs are linked, so nothing is gated
        ((3, 1.0, 1, 2, True), {"min_link": 0.0}, 0.5, 1),
    ],
)
def test_cohesion(given_, changed, density, connection):
    """method.md#member-sets."""
    found = cohesion(*given_, **changed)
    np.testing.assert_allclose(found, (density, connection), rtol=0, atol=ROUNDING)
