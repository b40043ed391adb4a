from typing import Any

import numpy as np
import pytest

from remind_jax.decision import Outcome
from remind_jax.errors import RemindError, SourceError
from remind_jax.metrics import evaluate, evaluate_tracks, pool_evaluations
from remind_jax.metrics.scene_evaluation import SceneOptions
from remind_jax.tracks import Tracks
from tests.outputs.fake_run import make_tracks

MATCH, NEW, SOFT = Outcome.MATCH, Outcome.NEW, Outcome.AMBIGUOUS


def frame(index: int, *rows: tuple[Any, ...]) -> Tracks:
    """Rows: instance, outcome, id, then perhaps candidates with scores, score and label."""
    told = []
    for instance, outcome, number, *more in rows:
        defaults: tuple[Any, ...] = ({}, 0.5, "cup")
        candidates, score, label = (*more, *defaults[len(more) :])
        told.append(
            {
                "instance_id": instance,
                "outcome": outcome,
                "object_id" if outcome in (MATCH, NEW) else "pending_id": number,
                "candidates": [*candidates.items()],
                "score": score,
                "label": label,
            }
        )
    return make_tracks(index, np.ones((len(rows), 4, 4), bool), told)


# Object 1 leaves after frame 1 and returns in frame 4, undecided at first; object 2 stays.
RUN = [
    frame(0, (1, NEW, 7), (2, NEW, 8)),
    frame(1, (1, MATCH, 7), (2, MATCH, 8)),
    frame(2, (2, MATCH, 8)),
    frame(3, (2, MATCH, 8)),
    frame(4, (1, SOFT, 0, {7: 0.9, 8: 0.8}), (2, MATCH, 8)),
    frame(5, (1, MATCH, 7), (2, MATCH, 8)),
]


def test_undecided_detections_are_missed_or_collapsed():
    strict, collapsed = (evaluate_tracks(RUN, undecided=u).scores() for u in ("strict", "collapse"))
    assert (strict["IDTP"], strict["IDFN"], strict["IDFP"]) == (9, 1, 0)
    assert (collapsed["IDTP"], collapsed["IDFN"], collapsed["IDFP"]) == (10, 0, 0)
    for scores in (strict, collapsed):
        assert (scores["Recovery"], scores["HardRecovery"]) == (1.0, 0.0)
        assert (scores["IDs"], scores["GT_IDs"], scores["IDSW"]) == (2, 2, 0)
        assert scores["CandidateHitRate"] == 1.0
        assert scores["AmbiguousShare"] == pytest.approx(1 / 10)


def test_an_id_given_twice_stays_with_the_better_score():
    run = [
        frame(0, (1, NEW, 7), (2, NEW, 8)),
        frame(1, (1, MATCH, 7, {}, 0.6), (2, MATCH, 7, {}, 0.9)),
    ]
    scores = evaluate_tracks(run).scores()
    assert scores["RepeatedIDs"] == 1
    assert scores["Dets"] == 3
    assert scores["IDSW"] == 1  # object 2 was 8, is 7


def test_every_class_apart():
    run = [frame(t, (1, MATCH, 7), (2, MATCH, 8 + t, {}, 0.5, "box")) for t in range(2)]
    evaluation = evaluate_tracks(run, by_class=True)
    assert {c: e.scores()["IDF1"] for c, e in evaluation.by_class.items()} == {"cup": 1, "box": 0.5}
    pooled = pool_evaluations([evaluation, evaluation])
    assert pooled.by_class["box"].scores()["IDTP"] == 2
    assert pooled.scores()["GT_IDs"] == 4


def test_pooled_recovery_keeps_objects_apart():
    pooled = pool_evaluations([evaluate_tracks(RUN), evaluate_tracks(RUN)])
    assert pooled.recovery.opportunities.tolist() == [1, 0, 1, 0]
    assert pooled.scores()["Recovery"] == 1.0
    assert pooled.uncertainty.ambiguous == 2


def test_an_empty_run_is_nothing():
    assert evaluate_tracks([]).scores()["GT_Dets"] == 0
    assert evaluate_tracks([frame(0)]).scores()["Frames"] == 1


def test_bad_runs_are_refused():
    with pytest.raises(SourceError, match="no detection has a true instance id"):
        evaluate_tracks([frame(0, (-1, NEW, 7))])
    with pytest.raises(SourceError, match="frame 0: ground truth id 1 occurs 2 times"):
        evaluate_tracks([frame(0, (1, NEW, 7), (1, NEW, 8))])
    with pytest.raises(SourceError, match="frame 0 follows frame 1"):
        evaluate_tracks([frame(1, (1, NEW, 7)), frame(0, (1, MATCH, 7))])
    undecided: Any = "collapsed"
    with pytest.raises(RemindError, match="undecided is 'collapsed'; did you mean 'collapse'"):
        evaluate_tracks([], undecided=undecided)


def test_unknown_formats_are_refused():
    unknown: Any = "coco-vid"
    with pytest.raises(
        RemindError,
        match="format is 'coco-vid'; did you mean 'coco-video'",
    ):
        evaluate("gt", "pred", format=unknown)


def test_options_that_cannot_be_are_refused():
    for name, wrong in (("num_frames", 4.5), ("class_id", "x"), ("min_absence_frames", 0)):
        with pytest.raises(RemindError, match=f"'{name}' is"):
            SceneOptions(**{name: wrong})
    with pytest.raises(RemindError, match="by_class"):
        SceneOptions(by_class="no")  # pyright: ignore[reportArgumentType]
