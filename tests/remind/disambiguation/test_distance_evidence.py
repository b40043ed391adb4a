import numpy as np
import pytest

from remind_jax.remind.disambiguation.distance_evidence import (
    rate_difference,
    rate_reliability,
    read_edges,
    read_orders,
    tabulate_edges,
)
from remind_jax.remind.memory.distances import empty_distances
from remind_jax.remind.perception.relations import Contact

from .scenes import thresholds

pytestmark = pytest.mark.usefixtures("x64")
DIGITS = 1e-6  # the page gives six decimals


def test_reliability_of_the_page():
    values = rate_reliability(np.arange(8), np.dtype("float64"))
    expected = [0, 0.408248, 0.577350, 0.707107, 0.816497, 0.912871, 1, 1]
    np.testing.assert_allclose(values, expected, atol=DIGITS)


def test_strength_of_the_page():
    values = rate_difference(np.array([-1, 0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6]), 0.2, thresholds())
    expected = [0, 0, 0.011555, 0.059607, 0.236021, 0.609001, 0.927963, 0.998057]
    np.testing.assert_allclose(values, expected, atol=DIGITS)


def test_robustness_of_the_page():
    """Margins 0.3, 0.5, 0.1, 0.4; the third time the other object was nearer.

    Rule: method.md#example-relations.
    """
    graph = empty_distances(3, np.dtype("float64"))
    margins = np.array([0.3, 0.5, 0.1, 0.4])
    graph.nearer[2, 0, 1], graph.nearer[2, 1, 0] = 3, 1
    graph.margin[2, 0, 1] = margins.mean()
    graph.margin[2, 1, 0] = np.sum((margins - margins.mean()) ** 2)
    for x, y in ((0, 1), (1, 0)):
        order = read_orders(graph, 2, x, y, np.array(True), thresholds())
        assert order.seen
        np.testing.assert_allclose(order.first, 0.75)
        np.testing.assert_allclose(order.consistency, 0.75)
        np.testing.assert_allclose(order.margin, 0.325)
        np.testing.assert_allclose(order.robustness, 0.434341, atol=DIGITS)
    unseen = read_orders(graph, 1, 0, 2, np.array(True), thresholds())
    assert not unseen.seen
    assert unseen.robustness == 0
    unknown = read_orders(graph, 2, 0, 1, np.array(False), thresholds())
    assert not unknown.seen


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
