"""Frames of a run that goes on for days are on disk, and come back as they were."""

import numpy as np

from remind_jax.outputs.writer import KeptTracks
from remind_jax.tracks import Tracks
from tests.outputs.fake_run import make_run


def same(one: Tracks, other: Tracks) -> bool:
    return all(
        np.array_equal(value, getattr(other, name), equal_nan=value.dtype.kind == "f")
        and value.dtype == getattr(other, name).dtype
        if isinstance(value, np.ndarray)
        else value == getattr(other, name)
        for name, value in vars(one).items()
    )


def test_frames_come_back_while_more_are_added(tmp_path):
    frames = make_run(6)[1].tracks
    kept = KeptTracks(tmp_path)
    for tracks in frames[:3]:
        kept.append(tracks)
    assert len(list(kept)) == 3
    for tracks in frames[3:]:
        kept.append(tracks)
    assert [same(*pair) for pair in zip(frames, kept, strict=True)] == [True] * 6
    assert list(tmp_path.iterdir()) == []  # the file has no name, so nothing is left
