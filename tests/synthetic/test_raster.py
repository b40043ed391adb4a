import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.synthetic.mesh import build_mesh
from remind_jax.synthetic.raster import NO_FACE, Camera, see_faces
from remind_jax.synthetic.scene import Look, Pose
from remind_jax.synthetic.shapes import CLASSES, build_object
from remind_jax.synthetic.surfaces import quad

GREY = np.full((8, 8, 3), 128, np.uint8)


def camera(pose, width=120, height=90):
    return Camera.at(pose, np.radians(60), width, height)


def test_a_square_ahead_covers_its_projection():
    # 1 m wide at 2 m: 0.5 focal lengths wide.
    view = camera(Pose((0.0, 0.0, 0.0), 0.0, 0.0))
    square = quad((2.0, 0.5, 0.5), (0, -1, 0), (0, 0, -1), GREY)
    seen, _ = see_faces(build_mesh([square]), view)
    rows, columns = np.nonzero(seen == 0)
    # A pixel's middle may lie just inside or outside at either end.
    assert np.ptp(columns) + 1 == pytest.approx(view.focal_px / 2, abs=1)
    assert np.ptp(rows) + 1 == pytest.approx(view.focal_px / 2, abs=1)
    assert columns.mean() == pytest.approx(59.5, abs=0.5)


def test_the_back_of_a_square_is_not_seen():
    square = quad((2.0, -0.5, 0.5), (0, 1, 0), (0, 0, -1), GREY)
    seen, _ = see_faces(build_mesh([square]), camera(Pose((0.0, 0.0, 0.0), 0.0, 0.0)))
    assert (seen == NO_FACE).all()


def test_the_nearer_face_wins_whatever_the_order():
    near = quad((2.0, 0.2, 0.2), (0, -0.4, 0), (0, 0, -0.4), GREY)
    far = quad((3.0, 1.0, 1.0), (0, -2, 0), (0, 0, -2), GREY)
    view = camera(Pose((0.0, 0.0, 0.0), 0.0, 0.0))
    one, _ = see_faces(build_mesh([near, far]), view)
    other, _ = see_faces(build_mesh([far, near]), view)
    np.testing.assert_array_equal(one == 0, other == 1)
    assert one[45, 60] == 0


@settings(max_examples=40, deadline=None)
@given(
    yaw=st.floats(-3.1, 3.1),
    pitch=st.floats(-1.2, 1.2),
    roll=st.floats(-3.1, 3.1),
    x=st.floats(-0.9, 0.9),
    y=st.floats(-0.9, 0.9),
)
def test_a_closed_room_has_no_holes(yaw, pitch, roll, x, y):
    walls = [
        quad((-1, 1, 1), (2, 0, 0), (0, 0, -2), GREY),
        quad((1, -1, 1), (-2, 0, 0), (0, 0, -2), GREY),
        quad((1, 1, 1), (0, -2, 0), (0, 0, -2), GREY),
        quad((-1, -1, 1), (0, 2, 0), (0, 0, -2), GREY),
        quad((-1, 1, -1), (2, 0, 0), (0, -2, 0), GREY),
        quad((-1, -1, 1), (2, 0, 0), (0, 2, 0), GREY),
    ]
    seen, _ = see_faces(build_mesh(walls), camera(Pose((x, y, 0.0), yaw, pitch, roll)))
    # The borders of clipped walls are computed twice, so a pixel on one may be lost to rounding.
    assert (seen == NO_FACE).sum() <= 2


@pytest.mark.parametrize("label", sorted(CLASSES))
def test_every_class_shows_a_plausible_silhouette_from_all_sides(label):
    parts = build_object(label, Look(1, 2), 1.0)
    mesh = build_mesh([surface for part in parts for surface in part.surfaces])
    middle = np.mean(mesh.corners, axis=0)
    half = np.max(CLASSES[label].size_m) / 2
    angles = [-np.pi / 2] if CLASSES[label].place == "wall" else np.arange(4) * np.pi / 2
    for angle in angles:
        away = 6 * half * np.array([np.cos(angle), np.sin(angle), 0.15])
        position = tuple((middle + away).tolist())
        view = camera(Pose(position, float(angle + np.pi), float(-np.arctan(0.15))), 160, 160)
        seen, _ = see_faces(mesh, view)
        share = (seen != NO_FACE).mean()
        assert 0.005 < share < 0.2
        rows, columns = np.nonzero(seen != NO_FACE)
        assert 0 < rows.min() <= rows.max() < 159
        assert 0 < columns.min() <= columns.max() < 159
