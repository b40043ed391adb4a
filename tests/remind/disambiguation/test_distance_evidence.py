import numpy as np
import pytest

from remind_jax.remind.disambiguation.distance_evidence import (
    read_edges,
    tabulate_edges,
)
from remind_jax.remind.memory.distances import empty_distances
from remind_jax.remind.perception.relations import Contact

from .scenes import thresholds

pytestmark = pytest.mark.usefixtures("x64")


def test_edges_prefer_the_gap():
    remembered = empty_distances(3, np.dtype("float64")).edges
    remembered.contact_count[0, 1:, Contact.SEPARATE] = [3, 1]
    remembered.gap_count[0, 1] = 2
    remembered.gap_mean[0] = 0.25
    remembered.center_mean[0] = 1.5
    table = tabulate_edges(remembered, thresholds())
    edges = read_edges(table, np.array(0), np.arange(3), np.array(True))
    np.testing.assert_array_equal(edges.usable, [False, True, True])
    np.testing.assert_array_equal(edges.has_gap, [False, True, False])
    np.testing.assert_array_equal(edges.distance[1:], [0.25, 1.5])
    strict = tabulate_edges(remembered, thresholds(min_reliability=0.5))
    edges = read_edges(strict, np.array(0), np.arange(3), np.array([True, True, True]))
    np.testing.assert_array_equal(edges.usable, [False, True, False])
    edges = read_edges(table, np.array(0), np.arange(3), np.array([True, False, True]))
    np.testing.assert_array_equal(edges.usable, [False, False, True])
