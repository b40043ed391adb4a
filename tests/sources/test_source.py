from __future__ import annotations

import json

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.frame import Detections, SkippedFrame
from remind_jax.sources import Sampling, Source
from remind_jax.sources.source import Content, Entry, SampledSource, UnreadableFrame

from . import making


class Reader:
    """Pictures of given sizes; None for one that cannot be read."""

    kind, name, fps, entry_names = "made", "made", 10.0, None

    def __init__(self, *sizes):
        self.sizes, self.num_entries, self.is_closed = sizes, len(sizes), False

    def entries(self, report):
        try:
            for index, size in enumerate(self.sizes):
                yield Entry(index, index / 10, f"{index}", lambda size=size: self.read(size))
            report(SkippedFrame("end", "it is cut off", 7))
        finally:
            self.is_closed = True

    def read(self, size):
        if size is None:
            raise UnreadableFrame("it is damaged")
        return Content(making.picture(0, size))


class Masks:
    """One detection in every frame."""

    notes = ["one sentence"]  # noqa: RUF012
    frames = None

    def detections_of(self, entry, frame_size):
        return Detections.create(np.ones((1, *frame_size), bool))


def test_frames_are_numbered_anew_and_what_cannot_be_read_is_skipped():
    source = SampledSource(Reader((8, 8), None, (8, 8), (8, 6)))
    assert isinstance(source, Source)
    frames = list(source)
    assert [(f.index, f.source_index, f.time_s) for f in frames] == [(0, 0, 0.0), (1, 2, 0.2)]
    assert [(s.name, s.count) for s in source.skipped] == [("1", 1), ("3", 1), ("end", 7)]
    assert "its size is 6x8, but the sequence is 8x8" in source.skipped[1].reason
    list(source)
    assert len(source.skipped) == 3  # of the latest pass only


def test_frames_of_other_sizes_on_request():
    frames = list(SampledSource(Reader((8, 8), (8, 6)), allow_size_change=True))
    assert [frame.size for frame in frames] == [(8, 8), (8, 6)]


def test_sampling_shows_in_count_and_rate_and_closes_the_storage():
    reader = Reader(*[(8, 8)] * 9)
    source = SampledSource(reader, sampling=Sampling(stride=2, max_frames=3))
    assert (source.num_frames, source.fps) == (3, 5.0)
    assert [frame.source_index for frame in source] == [0, 2, 4]
    assert reader.is_closed


def test_masks_come_with_every_frame_and_their_notes_with_the_source():
    source = SampledSource(Reader((8, 8)), Masks())
    assert source.notes == ["one sentence"]
    assert [making.detections_in(frame).masks.shape for frame in source] == [(1, 8, 8)]


def test_masks_need_images():
    reader = Reader((8, 8))
    reader.read = lambda size: Content(features=np.zeros((1, 1, 3), np.float32))
    with pytest.raises(SourceError, match="no images that the masks could belong to"):
        list(SampledSource(reader, Masks()))


@pytest.mark.parametrize(
    ("sizes", "sampling", "why"),
    [
        ((), None, "'made' has no frames"),
        (((8, 8),), Sampling(start=3), "the first one asked for is number 3; lower the start"),
        ((None, None), None, r"none of the 9 frames of 'made' .* first was '0': it is damaged"),
    ],
)
def test_without_frames_it_says_why(sizes, sampling, why):
    with pytest.raises(SourceError, match=why):
        list(SampledSource(Reader(*sizes), sampling=sampling))


def test_the_description_is_json():
    source = SampledSource(Reader((8, 8)), reopen={"spec": "a.mp4"})
    described = json.loads(json.dumps(source.describe()))
    assert described == {
        "kind": "made",
        "name": "made",
        "num_frames": 1,
        "fps": 10.0,
        "reopen": {"spec": "a.mp4"},
    }
