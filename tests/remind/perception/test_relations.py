import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.observation import MaskRelations, Masks
from remind_jax.remind.perception.relations import Contact, observe_relations
from remind_jax.remind.thresholds.relations import Relations as Rules
from tests.statics import only

FLOAT32 = 3e-6  # of coordinates in the hundreds, normalized by at least 40
_observe = jax.jit(observe_relations)


def observe(boxes, gap_px=None, areas=None, centers=None, border=None, **rules):
    """Relates detections by boxes; without `gap_px` no gap was measured between masks."""
    boxes = np.array(boxes, float)
    num = len(boxes)
    size = boxes[:, 2:] - boxes[:, :2]
    exact = np.zeros((num, num), bool) if gap_px is None else np.isfinite(gap_px)
    relations = MaskRelations(
        gap_px=np.where(exact, gap_px if gap_px is not None else 0.0, 0.0),
        exact=exact,
        touches_border=np.zeros(num, bool) if border is None else np.array(border),
    )
    masks = only(
        Masks,
        box=boxes,
        center=(boxes[:, :2] + boxes[:, 2:] - 1) / 2 if centers is None else np.array(centers),
        area=size.prod(axis=1) if areas is None else np.array(areas, float),
        relations=relations,
        valid=np.ones(num, bool),
    )
    return _observe(masks, jax.tree.map(jnp.asarray, Rules(**rules)))


A, B, C = (50, 50, 110, 100), (130, 60, 160, 90), (60, 60, 80, 80)
F, G = (112, 102, 130, 120), (280, 0, 300, 30)
NAN = np.nan


def test_boxes_stand_in_for_gaps_that_were_not_measured():
    found = observe([A, B, G], border=[True, False, False])
    assert found.gap[0, 1] == pytest.approx(0.471852, abs=FLOAT32)  # method.md#example-relations
    # cut by the edge, the box of A may end anywhere
    np.testing.assert_array_equal(found.gap_quality[0], [0, 0, 1])
    np.testing.assert_array_equal(found.gap_quality[1], [0, 0.5, 1])
    np.testing.assert_array_equal(found.gap_valid[0], [False, False, True])
    np.testing.assert_array_equal(found.distance[0, 1], found.center_distance[0, 1])
    np.testing.assert_array_equal(found.distance[0, 2], found.gap[0, 2])


@pytest.mark.parametrize(
    ("gap_px", "contact"),
    [
        (-1.0, Contact.OVERLAP),
        (0.0, Contact.TOUCH),
        (2.0, Contact.TOUCH),
        (2.5, Contact.NEAR),
        (50.0, Contact.NEAR),  # 1.25 sides
        (50.5, Contact.SEPARATE),
    ],
)
def test_contact(gap_px, contact):
    boxes = [(0, 0, 40, 40), (41, 0, 81, 40)]
    found = observe(boxes, np.array([[NAN, gap_px], [gap_px, NAN]]))
    assert found.contact[0, 1] == contact


BIG = (0, 0, 100, 100)


@pytest.mark.parametrize(
    ("small", "area", "gap_px", "support"),
    [
        ((10, 10, 30, 30), 400, -20.0, 1.0),  # inside the box of the other
        ((90, 40, 130, 60), 800, 1.0, 0.25),  # a quarter of it
        ((90, 40, 110, 60), 400, 1.0, 0.75),  # half of it, center on the edge of the other
        ((92, 40, 108, 60), 320, 1.0, 0.75),  # center inside
        ((92, 40, 108, 60), 320, 99.0, 0.5),  # but the masks are apart
        ((0, 0, 78, 78), 6001, -60.0, 0.0),  # more than 0.6 of the size: no support
        ((0, 0, 78, 78), 6000, -60.0, 1.0),
    ],
)
def test_support(small, area, gap_px, support):
    gaps = np.array([[NAN, gap_px], [gap_px, NAN]])
    centers = [(49.5, 49.5), ((small[0] + small[2]) / 2, 49.5)]
    found = observe([BIG, small], gaps, areas=[10000, area], centers=centers)
    assert found.support[0, 1] == found.support[1, 0] == pytest.approx(support)
