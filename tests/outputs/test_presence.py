"""When identities were seen, gone and back."""

from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from remind_jax.outputs.presence import find_presences, join_positions
from tests.outputs.fake_run import make_run


@given(st.lists(st.integers(0, 60)))
def test_spans_hold_all_positions_and_touch_nowhere(positions):
    spans = join_positions(sorted(positions))
    assert [p for first, last in spans for p in range(first, last + 1)] == sorted(set(positions))
    assert all(one[1] + 1 < other[0] for one, other in itertools.pairwise(spans))


def test_histories_number_frames_where_presences_count_them():
    _, result = make_run(60)
    present = find_presences(result.tracks)
    number = [tracks.frame_index for tracks in result.tracks]
    for one, history in zip(present, result.objects(), strict=True):
        assert (one.object_id, one.num_frames) == (history.object_id, history.num_frames)
        assert history.returns == tuple(number[position] for position in one.returns)
        assert history.first_frame == number[one.seen[0][0]]


def test_shorter_gaps_are_no_absence():
    _, result = make_run(30)
    usual, longest = (find_presences(result.tracks, least)[1] for least in (5, 14))
    assert usual.absences == ((10, 22),)
    assert longest.absences == ()
    assert usual.seen == longest.seen == ((0, 9), (23, 29))
