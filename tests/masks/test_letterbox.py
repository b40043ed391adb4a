import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.masks.letterbox import Letterbox


def to_input(box: Letterbox, boxes: np.ndarray) -> np.ndarray:
    """Boxes of the frame in the input, by the sizes and bars that the letterbox has chosen."""
    height, width = np.divide(box.scaled_size, box.frame_size)
    return boxes * [width, height, width, height] + [box.left_px, box.top_px] * 2


sides = st.integers(1, 900)
frames = st.tuples(sides, sides)
inputs = st.tuples(st.integers(32, 700), st.integers(32, 700))


@given(frame_size=frames, input_size=inputs)
def test_the_frame_lies_in_the_middle_and_touches_two_sides(frame_size, input_size):
    box = Letterbox.fit(frame_size, input_size)
    below = input_size[0] - box.top_px - box.scaled_size[0]
    right = input_size[1] - box.left_px - box.scaled_size[1]
    assert below - box.top_px in (0, 1)
    assert right - box.left_px in (0, 1)
    assert min(box.top_px + below, box.left_px + right) == 0


@given(frame_size=frames, input_size=inputs, data=st.data())
def test_boxes_survive_the_round_trip(frame_size, input_size, data):
    box = Letterbox.fit(frame_size, input_size)
    height, width = frame_size
    xs = sorted(data.draw(st.tuples(st.floats(0, width), st.floats(0, width))))
    ys = sorted(data.draw(st.tuples(st.floats(0, height), st.floats(0, height))))
    drawn = np.array([[xs[0], ys[0], xs[1], ys[1]]])
    there = to_input(box, drawn)
    assert (there[:, :2] >= [box.left_px, box.top_px]).all()
    # Rounding of one multiplication and one division, in pixels.
    np.testing.assert_allclose(box.boxes_to_frame(there), drawn, atol=1e-9)


@given(frame_size=frames, input_size=inputs, slope=st.tuples(st.floats(-1, 1), st.floats(-1, 1)))
def test_maps_come_back_to_the_pixel_centers(frame_size, input_size, slope):
    """Bilinear resampling keeps a sloping plane, so any shift or wrong scale would show."""
    box = Letterbox.fit(frame_size, input_size)
    centers_y, centers_x = np.indices(input_size) + 0.5
    corners = np.stack([centers_x.ravel(), centers_y.ravel()] * 2, axis=1)
    in_frame = box.boxes_to_frame(corners)[:, :2]
    plane = (in_frame @ slope).reshape(input_size).astype(np.float32)
    came_back = box.plane_to_frame(plane)
    assert came_back.shape == frame_size
    # Beyond the outermost input pixel centers the plane is continued as a constant.
    margin_y, margin_x = np.ceil(0.5 * np.divide(frame_size, box.scaled_size)).astype(int)
    rows, columns = np.indices(frame_size) + 0.5
    expected = columns * slope[0] + rows * slope[1]
    middle = (
        slice(margin_y, frame_size[0] - margin_y),
        slice(margin_x, frame_size[1] - margin_x),
    )
    # float32 arithmetic on values up to 1,800 (one step is 1.2e-4); half a pixel would be allowed.
    np.testing.assert_allclose(came_back[middle], expected[middle], atol=1e-3)
