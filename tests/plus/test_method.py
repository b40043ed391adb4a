"""REMIND plus as users run it: by name, with answers that wait."""

from collections import Counter

import numpy as np
import pytest

import remind_jax as rj
from remind_jax.errors import ConfigError
from remind_jax.frame import Detections, Frame
from remind_jax.metrics import evaluate_tracks
from remind_jax.numerics.absent import NO_ID

SIDE = 96
COLORS = ((220, 40, 40), (40, 200, 60), (50, 80, 230), (230, 210, 50), (200, 60, 220))


def pan_frames() -> list[Frame]:
    """A camera that pans along five colored squares on a speckled wall, there and back."""
    rng = np.random.default_rng(0)
    wall = rng.integers(60, 190, (SIDE, 5 * SIDE // 2, 1), np.uint8).repeat(3, axis=2)
    lefts = np.linspace(12, 5 * SIDE // 2 - 52, 5).astype(int)
    instance = np.zeros(wall.shape[:2], int)
    for number, left in enumerate(lefts):
        wall[28:66, left : left + 36] = COLORS[number]
        instance[28:66, left : left + 36] = number + 1
    reach = wall.shape[1] - SIDE
    at = np.rint(reach * (0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, 44)))).astype(int)
    made = []
    for index, left in enumerate(at):
        view = instance[:, left : left + SIDE]
        ids = [i for i in np.unique(view) if i and (view == i).sum() > 100]
        masks = np.array([view == i for i in ids]).reshape(-1, SIDE, SIDE)
        found = Detections.create(masks, ["square"] * len(ids), instance_ids=ids)
        image = np.ascontiguousarray(wall[:, left : left + SIDE])
        made.append(Frame(index, index, float(index), str(index), image, found))
    return made


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return pan_frames()


@pytest.fixture(scope="module")
def result(frames) -> rj.Result:
    return rj.run(frames, config="plus", delay=0)


def test_squares_are_recognized_on_the_way_back(result):
    assert evaluate_tracks(result.tracks).scores()["IDF1"] > 0.9


def test_answers_that_wait_are_as_many_and_no_worse(frames, result):
    late = rj.run(frames, config="plus")  # it is recorded
    assert [t.frame_index for t in late.tracks] == [t.frame_index for t in result.tracks]
    scores = [evaluate_tracks(run.tracks).scores()["IDF1"] for run in (late, result)]
    assert scores[0] >= scores[1]
    for tracks in late.tracks:
        ids = tracks.object_id[tracks.object_id != NO_ID]
        assert len(ids) == len(np.unique(ids))


def test_other_trackers_do_not_revise(frames):
    with pytest.raises(ConfigError, match="never revises"):
        rj.run(frames, tracker="iou", delay=3)


def test_announcing_changes_no_answer_but_its_number(frames):
    at_once = rj.run(frames, config="plus", delay=8)
    announced = rj.run(frames, config="plus", delay=8, announce_after=3)
    number: dict[int, int] = {}
    for plain, told in zip(at_once.tracks, announced.tracks, strict=True):
        for old, new in zip(plain.object_id.tolist(), told.object_id.tolist(), strict=True):
            if new != NO_ID:
                assert number.setdefault(old, new) == new
    assert sorted(number.values()) == list(range(len(number)))
    seen = Counter(i for tracks in at_once.tracks for i in tracks.object_id.tolist())
    assert {old for old, count in seen.items() if count >= 3} - {NO_ID} == set(number)
