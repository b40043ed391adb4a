import cv2
import numpy as np
import pytest

from remind_jax.outputs.drawing import NO_IMAGE_GRAY
from remind_jax.outputs.gallery import CROP_PX, MAX_SIGHTINGS, SightingCollector, crop_detection
from remind_jax.outputs.presence import MIN_ABSENCE_FRAMES
from tests.outputs.fake_run import collect, make_run, make_tracks


def collect_of(presence: str):
    collector = SightingCollector()
    for index, seen in enumerate(presence):
        rows = [{"object_id": 3}] if seen == "x" else []
        collector.add(None, make_tracks(index, np.ones((len(rows), 12, 12), bool), rows))
    return collector.sightings


def test_crops_are_taken_at_the_returns_that_the_result_reports():
    frames, result = make_run(60)
    sightings = collect(frames, result)
    returns = [(history.object_id, at) for history in result.objects() for at in history.returns]
    taken = [(s.object_id, s.position) for s in sightings if s.absent_frames]
    assert sorted(taken) == sorted(returns)
    firsts = [s.object_id for s in sightings if not s.absent_frames]
    assert firsts == [0, 1, 2, 3, 4, 5]


def test_flicker_is_no_return():
    short, long = "." * (MIN_ABSENCE_FRAMES - 1), "." * MIN_ABSENCE_FRAMES
    assert len(collect_of(f"xx{short}x")) == 1
    (_, back) = collect_of(f"xx{long}x")
    assert back.absent_frames == MIN_ABSENCE_FRAMES


def test_crops_of_one_identity_are_limited():
    assert len(collect_of(("x" + "." * MIN_ABSENCE_FRAMES) * 20)) == MAX_SIGHTINGS


def square(left: int, top: int, side: int) -> np.ndarray:
    mask = np.zeros((90, 120), bool)
    mask[top : top + side, max(0, left) : left + side] = True
    return mask


def textured(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 255, (90, 120, 3), np.uint8)
    return cv2.GaussianBlur(noise, (5, 5), 0)


def best_of(views) -> tuple[int, SightingCollector]:
    """Which of the views of one visit is kept."""
    collector = SightingCollector()
    crops = []
    for index, (mask, image) in enumerate(views):
        tracks = make_tracks(index, mask[None], [{"object_id": 0}])
        collector.add(image, tracks)
        crops.append(crop_detection(image, tracks, 0).tobytes())
    (sighting,) = collector.sightings
    return crops.index(sighting.image.tobytes()), collector


def test_the_largest_view_of_a_visit_is_kept_and_its_frame_named():
    masks = [square(40, 30, side) for side in (8, 14, 30, 12)]
    kept, collector = best_of([(mask, textured(i)) for i, mask in enumerate(masks)])
    assert kept == 2
    (sighting,) = collector.sightings
    assert (sighting.position, sighting.picture_position) == (0, 2)


def test_an_object_alone_is_better_than_a_larger_view_with_another_of_its_class():
    alone, beside = square(40, 30, 24), square(40, 30, 30)
    collector, crops = SightingCollector(), []
    for index, masks in enumerate([[beside, square(50, 25, 30)], [alone, square(80, 30, 30)]]):
        rows = [{"object_id": number, "label": "person"} for number in range(2)]
        tracks = make_tracks(index, np.array(masks), rows)
        collector.add(None, tracks)
        crops.append(crop_detection(None, tracks, 0).tobytes())
    assert collector.sightings[0].image.tobytes() == crops[1]


@pytest.mark.parametrize(
    "two", [np.s_[15:65, 20:70], np.s_[10:70, 37:67]], ids=["side by side", "behind one another"]
)
def test_the_usual_shape_is_better_than_a_larger_one_of_two_people_in_one_mask(two):
    masks = np.zeros((5, 90, 120), bool)
    masks[:4, 20:60, 40:60] = True
    masks[4][two] = True
    assert best_of([(mask, textured()) for mask in masks])[0] == 0


@pytest.mark.parametrize("cut_off", [square(-10, 30, 40), square(90, 30, 40), square(40, 60, 40)])
def test_a_whole_view_is_better_than_a_larger_one_that_the_border_cuts_off(cut_off):
    whole = square(40, 30, 24)
    assert best_of([(cut_off, textured()), (whole, textured(1)), (cut_off, textured())])[0] == 1


def test_a_sharp_view_is_better_than_a_larger_blurred_one():
    blurred = cv2.GaussianBlur(textured(), (0, 0), 5)
    views = [(square(40, 30, 34), blurred), (square(40, 30, 28), textured(1))]
    assert best_of(views)[0] == 1
    assert best_of(views[::-1])[0] == 0


def test_without_images_the_size_decides():
    masks = [square(40, 30, side) for side in (8, 30, 12)]
    assert best_of([(mask, None) for mask in masks])[0] == 1


def test_crop_shows_the_object_in_its_middle():
    image = np.zeros((100, 140, 3), np.uint8)
    masks = np.zeros((2, 100, 140), bool)
    masks[0, 40:60, 60:80] = True
    masks[1, 0:90, 0:130] = True  # crop is smaller than the object
    image[masks[0]] = (10, 200, 30)
    tracks = make_tracks(0, masks, [{"object_id": 0}, {"object_id": 1}])
    small, large = (crop_detection(image, tracks, row) for row in range(2))
    assert small.shape == large.shape == (CROP_PX, CROP_PX, 3)
    # The box covers 20 / 26 of the crop: its middle half is all object, the rim all ground.
    quarter = CROP_PX // 4
    assert (small[quarter:-quarter, quarter:-quarter] == (10, 200, 30)).all()
    assert (small[:8] == 0).all()


def test_a_crop_of_a_large_object_shows_what_the_whole_frame_would():
    """Shrunk many times, at a corner of the frame."""
    rng = np.random.default_rng(0)
    image = np.kron(rng.integers(0, 255, (12, 12, 3), np.uint8), np.ones((100, 100, 1), np.uint8))
    mask = np.zeros((1, 1200, 1200), bool)
    mask[0, 300:, 300:] = True
    crop = crop_detection(image, make_tracks(0, mask, [{"object_id": 0}]), 0, 39)
    # The square has a side of 1170 pixels, 30 to each of the crop, and starts at 165; the outline
    # lies at the fifth.
    for row in range(10, 30):
        for column in range(10, 30):
            top, left = 165 + 30 * row, 165 + 30 * column
            shown = image[top : top + 30, left : left + 30].reshape(-1, 3).mean(axis=0)
            assert np.abs(crop[row, column] - shown).max() < 60, (row, column)
    assert (crop[38] == NO_IMAGE_GRAY).all()  # beyond the frame


@pytest.mark.parametrize("shape", [(4000, 16), (16, 4000)])
def test_a_crop_of_a_long_narrow_frame_is_cut(shape):
    image = np.full((*shape, 3), 90, np.uint8)
    crop = crop_detection(image, make_tracks(0, np.ones((1, *shape), bool), [{"object_id": 0}]), 0)
    assert crop.shape == (CROP_PX, CROP_PX, 3)
