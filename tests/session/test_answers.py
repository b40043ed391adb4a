"""The answers about a frame: outlines of masks, and which objects a detection names."""

import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.config import load_config
from remind_jax.decision import Outcome, Reason, no_decisions
from remind_jax.frame import Detections, Frame
from remind_jax.masks.run_length import decode_mask
from remind_jax.method import get_method
from remind_jax.session.answers import outline, read_tracks
from remind_jax.session.live import Tracker
from remind_jax.session.preparation import FramePreparer
from remind_jax.static import Static

STATIC = Static(num_detections=4, num_candidates=2)


def two_masks() -> np.ndarray:
    masks = np.zeros((2, 12, 16), bool)
    masks[0, 2:5, 1:7] = True
    return masks


def test_outlines_measure_their_masks():
    masks = two_masks()
    outlines = outline(masks)
    assert outlines.boxes.tolist() == [[1, 2, 7, 5], [0, 0, 0, 0]]  # the second is empty
    assert outlines.areas.tolist() == [18, 0]
    for mask, rle in zip(masks, outlines.rles, strict=True):
        np.testing.assert_array_equal(decode_mask(rle), mask)


def test_undecided_detections_name_their_options_and_others_the_nearest():
    decisions = jax.device_get(no_decisions(STATIC))
    outcome, option_id = np.array(decisions.outcome), np.array(decisions.option_id)
    candidate_id, option_score = np.array(decisions.candidate_id), np.array(decisions.option_score)
    outcome[:2] = Outcome.MATCH, Outcome.AMBIGUOUS
    candidate_id[:2] = [[7, 8], [8, 7]]
    option_id[1], option_score[1] = [5, 7, -1], [0.5, 0.25, 0.0]
    decisions = dataclasses.replace(
        decisions,
        outcome=outcome,
        option_id=option_id,
        option_score=option_score,
        candidate_id=candidate_id,
    )
    masks = two_masks()
    image = np.zeros((12, 16, 3), np.uint8)
    frame = Frame(3, 6, 0.5, "a", image, Detections.create(masks))
    prepared = FramePreparer(get_method("plus"), 4).prepare(frame, load_config())
    tracks = read_tracks(prepared, outline(masks), decisions)
    assert len(tracks) == 2  # padding slots are left out
    assert tracks.candidate_id.tolist() == [[7, 8, -1], [5, 7, -1]]
    assert tracks.candidate_score[1].tolist() == [0.5, 0.25, 0.0]
    assert (tracks.frame_index, tracks.source_index, tracks.time_s) == (3, 6, 0.5)


@pytest.mark.parametrize("name", ["plus", "bank"])
def test_an_empty_mask_is_dropped_and_no_object_that_might_be_new(name):
    tracker = Tracker(tracker=name)
    masks = np.zeros((2, 64, 96), bool)
    masks[1, 16:48, 16:48] = True
    tracks = tracker.update(np.zeros((64, 96, 3), np.uint8), {"masks": masks, "labels": ["a", "b"]})
    assert (tracks.outcome[0], tracks.reason[0]) == (Outcome.DROPPED, Reason.INVALID_INPUT)
    assert tracks.display_name(0) == "a"
    (event,) = tracker.events
    assert (event.kind, event.message) == ("dropped", "dropped 1 empty mask")
