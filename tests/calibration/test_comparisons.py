"""What may be compared, and that terms of the score are those of the tracker."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.calibration.comparisons import (
    NONE,
    QUERIES,
    VIEWS,
    Comparisons,
    Sightings,
    Views,
    compare_ends,
    compare_views,
)
from remind_jax.calibration.estimate import join


def sightings(tracks: list[tuple[int, int, range]]) -> Sightings:
    """From track, class and the frames that it is seen in."""
    rows = sorted((frame, track, kind) for track, kind, frames in tracks for frame in frames)
    frame, track, kind = np.array(rows, np.int32).T
    return Sightings(frame, track, kind)


def pairs(seen, found):
    """Query, memory and kind of each comparison, as frames and tracks."""
    for query, memory, same in zip(found.query, found.memory, found.same, strict=True):
        views = memory[memory != NONE]
        yield seen.frame[query], seen.track[query], seen.frame[views], seen.track[views], same


def test_ends_of_a_tracklet_are_compared_and_what_shares_a_frame_is_another_object():
    seen = sightings([(0, 0, range(30)), (1, 0, range(20, 50)), (2, 0, range(60, 90))])
    found = compare_ends(seen, np.random.default_rng(0))
    assert found.same.sum() == 3 * QUERIES
    met = set()
    for frame, track, frames, tracks, same in pairs(seen, found):
        assert 0 < len(frames) <= VIEWS
        assert (tracks == track).all() == same
        if same:
            assert abs(frames - frame).min() >= 10
        else:
            met.add((track, *set(tracks)))
    assert met == {(0, 1), (1, 0)}  # nobody knows whether the third is one of them


@settings(deadline=None, max_examples=5)
@given(st.integers(0, 100))
def test_one_seed_gives_one_choice(seed):
    seen = sightings([(track, track % 2, range(track, track + 12)) for track in range(30)])
    first, again = (compare_ends(seen, np.random.default_rng(seed)) for _ in range(2))
    assert np.array_equal(first.memory, again.memory)
    assert np.array_equal(first.query, again.query)
    within = first.only(first.same_class)
    assert within.same.sum() == first.same.sum()
    assert 0 < len(within.query) < len(first.query)


def unit(*angles):
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def views():
    angles = np.deg2rad
    return Views(
        appearance=np.stack([unit(*angles([0, 90, 60])), unit(*angles([0, 90, 30]))], axis=1),
        appearance_seen=np.array([[True, True], [True, True], [True, False]]),
        rings=np.stack([unit(*angles([0, 60, 60])), unit(*angles([0, 0, 90]))], axis=1),
        rings_seen=np.array([[True, True], [True, True], [True, False]]),
        parts=np.stack([unit(*angles([0, 0, 60])), unit(*angles([30, 90, 60]))], axis=1),
        parts_seen=np.array([[True, True], [True, False], [False, False]]),
    )


def compared(query, *memories):
    rows = [(query, np.array(memory), True, True) for memory in memories]
    return compare_views(views(), Comparisons.of(rows), (0.6, 0.4), 3)


def test_terms_of_a_query_with_memories():
    found = compared(0, [1], [2], [1, 2])
    assert found.present.tolist() == [[True] * 3, [True, True, False], [True] * 3]
    half, parts = 0.5, (1 + np.cos(np.deg2rad(30))) / 2
    wanted = [[0, 0.6 * half + 0.4, parts], [half, half, 0], [half, 0.6 * half + 0.4, parts]]
    assert found.value == pytest.approx(np.array(wanted), abs=1e-12)


def test_parts_close_to_a_stronger_one_are_dropped():
    merged = views().merge_parts(0.8).parts_seen
    assert merged.tolist() == [[True, False], [True, False], [False, False]]
    assert views().merge_parts(0.9).parts_seen.tolist() == views().parts_seen.tolist()
    assert views().part_cosines() == pytest.approx([np.cos(np.deg2rad(30))])


def test_views_of_frames_one_after_the_other():
    joined = join([views(), views()])
    assert len(joined.parts) == 6
    assert joined.num_bytes == 2 * views().num_bytes
