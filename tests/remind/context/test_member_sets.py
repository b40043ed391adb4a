"""How well the members of a set hold together, at the edges of its settings.

Rule: method.md#member-sets. The frozen scenes have the sets themselves.
"""

import numpy as np
import pytest

from remind_jax.remind.context.member_sets import LinkCounts, rate_cohesion

from .scenes import thresholds

pytestmark = pytest.mark.usefixtures("x64")
ROUNDING = 1e-12  # float64, a handful of operations on numbers below 1


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
    found = cohesion(*given_, **changed)
    np.testing.assert_allclose(found, (density, connection), rtol=0, atol=ROUNDING)
