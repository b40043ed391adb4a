import numpy as np

from remind_jax.outputs.gallery import (
    CROP_PX,
    MAX_SIGHTINGS,
    SightingCollector,
    crop_detection,
    draw_gallery,
)
from remind_jax.result import MIN_ABSENCE_FRAMES
from tests.outputs.fake_run import make_run, make_tracks


def collect(presence: str):
    collector = SightingCollector()
    for index, seen in enumerate(presence):
        rows = [{"object_id": 3}] if seen == "x" else []
        collector.add(None, make_tracks(index, np.ones((len(rows), 12, 12), bool), rows))
    return collector.sightings


def test_crops_are_taken_at_the_returns_that_the_result_reports():
    frames, result = make_run(60)
    collector = SightingCollector()
    for frame, tracks in zip(frames, result.tracks, strict=True):
        collector.add(frame.image, tracks)
    told = [(history.object_id, at) for history in result.objects() for at in history.returns]
    taken = [(s.object_id, s.frame_index) for s in collector.sightings if s.absent_frames]
    assert sorted(taken) == sorted(told)
    firsts = [s.object_id for s in collector.sightings if not s.absent_frames]
    assert firsts == [0, 1, 2, 3, 4, 5]


def test_flicker_is_no_return():
    short, long = "." * (MIN_ABSENCE_FRAMES - 1), "." * MIN_ABSENCE_FRAMES
    assert len(collect(f"xx{short}x")) == 1
    (_, back) = collect(f"xx{long}x")
    assert back.absent_frames == MIN_ABSENCE_FRAMES


def test_crops_of_one_identity_are_limited():
    assert len(collect(("x" + "." * MIN_ABSENCE_FRAMES) * 20)) == MAX_SIGHTINGS


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


def test_gallery_without_identities_is_a_picture():
    assert draw_gallery([], "nothing").ndim == 3


def test_every_crop_is_on_the_picture():
    frames, result = make_run(60)
    collector = SightingCollector()
    for frame, tracks in zip(frames, result.tracks, strict=True):
        collector.add(frame.image, tracks)
    picture = draw_gallery(collector.sightings, "tour")
    for sighting in collector.sightings:
        assert sighting.image[CROP_PX // 2].tobytes() in picture.tobytes()
