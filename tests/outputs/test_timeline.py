import dataclasses

import numpy as np
import pytest

from remind_jax.outputs.palette import identity_color
from remind_jax.outputs.result import Result
from remind_jax.outputs.timeline import build_timeline, draw_timeline
from tests.outputs.fake_run import make_info, make_run, make_tracks


def test_rows_follow_first_sight():
    _, result = make_run(30)
    late_first = dataclasses.replace(result, tracks=result.tracks[10:])  # 1, 3, 5 come back at 20
    assert [row.object_id for row in build_timeline(late_first).rows] == [0, 2, 4, 3, 5, 1]


def test_runs_absences_and_doubt():
    _, result = make_run(30)
    timeline = build_timeline(result)
    row = timeline.rows[1]
    assert row.seen == ((0, 9), (23, 29))
    assert row.absences == ((10, 22),)
    assert row.returns == (23,)
    assert row.candidate == ((20, 22),)
    assert timeline.rows[0].candidate == ((20, 22),)
    assert timeline.rows[4].absences == ()  # one frame is flicker
    assert timeline.ambiguous == ((20, 22),)
    assert timeline.provisional == ((20, 20),)


def test_timeline_agrees_with_the_histories():
    _, result = make_run(60)
    by_id = {row.object_id: row for row in build_timeline(result).rows}
    for history in result.objects():
        row = by_id[history.object_id]
        assert row.absences == history.absences
        assert row.returns == history.returns


@pytest.mark.parametrize(("num_objects", "num_frames"), [(0, 0), (0, 3), (1, 1), (70, 3)])
def test_any_size_is_drawn(num_objects, num_frames):
    masks = np.ones((num_objects, 4, 4), bool)
    rows = [{"object_id": i, "label": "a rather long class name"} for i in range(num_objects)]
    tracks = tuple(make_tracks(i, masks, rows) for i in range(num_frames))
    picture = draw_timeline(Result(tracks, make_info()))
    assert picture.dtype == np.uint8
    # All bars reach the right end of the plot.
    shown = {tuple(pixel) for pixel in picture[:, -60].tolist()}
    assert {identity_color(i) for i in range(num_objects if num_frames else 0)} <= shown
